// A specification as a person types it: one row per quantity, a lower and an upper limit.

import type { LimitPair, Specification } from './types';

export interface LimitRow {
  readonly quantity: string;
  lower: string;
  upper: string;
}

/** Quantities that can have limits, in the order of the form. */
export const QUANTITIES = ['theta_r_deg', 'alpha_u', 'alpha_v', 'rho_d', 'contrast_mean', 'contrast_michelson_mean'] as const;

export function emptyRows(): LimitRow[] {
  return QUANTITIES.map((quantity) => ({ quantity, lower: '', upper: '' }));
}

/** A typed number; a decimal comma is accepted. Null if empty, NaN if it is not a number. */
export function typed(text: string): number | null {
  const trimmed = text.trim().replace('−', '-').replace(',', '.');
  if (trimmed === '') return null;
  return /^[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$/i.test(trimmed) ? Number(trimmed) : Number.NaN;
}

/** What is wrong with a row, or null. */
export function rowProblem(row: LimitRow): string | null {
  const [lower, upper] = [typed(row.lower), typed(row.upper)];
  if (Number.isNaN(lower) || Number.isNaN(upper)) return 'give a number or leave it empty';
  if (lower !== null && upper !== null && lower >= upper) return 'the lower limit is not below the upper';
  return null;
}

/** The specification of the rows; null without a limit or with an invalid row. */
export function specificationOf(name: string, rows: readonly LimitRow[]): Specification | null {
  if (rows.some((row) => rowProblem(row) !== null)) return null;
  const limits: Record<string, LimitPair> = {};
  for (const row of rows) {
    const [lower, upper] = [typed(row.lower), typed(row.upper)];
    if (lower === null && upper === null) continue;
    limits[row.quantity] = { ...(lower === null ? {} : { lower }), ...(upper === null ? {} : { upper }) };
  }
  return Object.keys(limits).length === 0 ? null : { name: name.trim() === '' ? 'limits of the page' : name.trim(), limits };
}

/** The rows of a specification, so that the last one can be edited and used again. */
export function rowsOf(specification: Specification): LimitRow[] {
  const text = (x: number | null | undefined): string => (x == null ? '' : String(x));
  const known = emptyRows().map((row) => {
    const pair = specification.limits[row.quantity];
    return { ...row, lower: text(pair?.lower), upper: text(pair?.upper) };
  });
  const others = Object.entries(specification.limits).filter(([quantity]) => !known.some((row) => row.quantity === quantity));
  return [...known, ...others.map(([quantity, pair]) => ({ quantity, lower: text(pair.lower), upper: text(pair.upper) }))];
}
