// A specification as a person types it: one row per quantity, a lower and an upper limit; and the accepted risks.

import { plain } from './format';
import { typed } from './typed';
import type { LimitPair, Specification } from './types';
import { QUANTITIES as WORDS } from './words';

export interface LimitRow {
  readonly quantity: string;
  lower: string;
  upper: string;
}

/** Quantities that can have limits, in the order of the form. */
export const QUANTITIES = ['theta_r_deg', 'alpha_u', 'alpha_v', 'rho_d', 'translucency', 'crest_radius', 'land_share', 'contrast_mean', 'contrast_michelson_mean'] as const;

export function emptyRows(): LimitRow[] {
  return QUANTITIES.map((quantity) => ({ quantity, lower: '', upper: '' }));
}

/** What is wrong with a row, or null. */
export function rowProblem(row: LimitRow): string | null {
  const [lower, upper] = [typed(row.lower), typed(row.upper)];
  if (Number.isNaN(lower) || Number.isNaN(upper)) return 'give a number or leave it empty';
  if (lower !== null && upper !== null && lower >= upper) return lower > upper ? 'the lower limit is above the upper one' : 'the lower and the upper limit are the same';
  return null;
}

/** How a specification decides, as typed. */
export interface RuleDraft {
  /** Percent. */
  accept: string;
  reject: string;
  /** Empty: either plane. */
  plane: '' | 'turntable' | 'sample';
}

/** The daemon's risk where a specification states none. */
const RISK = 0.025;

export const newRules = (): RuleDraft => ({ accept: String(100 * RISK), reject: String(100 * RISK), plane: '' });

export function rulesOf({ decision, reference_plane }: Specification): RuleDraft {
  const percent = (risk: number | undefined): string => String(Number((100 * (risk ?? RISK)).toPrecision(12)));
  return { accept: percent(decision?.max_false_accept_risk), reject: percent(decision?.max_false_reject_risk), plane: reference_plane ?? '' };
}

/** What is wrong with a risk, or null. */
export function riskProblem(text: string): string | null {
  const risk = typed(text);
  return risk !== null && risk > 0 && risk < 50 ? null : 'give a percentage above 0 and below 50';
}

/** The specification of the rows; null without a limit or with an invalid value. */
export function specificationOf(name: string, rows: readonly LimitRow[], rules: RuleDraft = newRules()): Specification | null {
  if (rows.some((row) => rowProblem(row) !== null) || riskProblem(rules.accept) !== null || riskProblem(rules.reject) !== null) return null;
  const risk = (text: string): number => Number(((typed(text) ?? Number.NaN) / 100).toPrecision(12));
  const decision = { max_false_accept_risk: risk(rules.accept), max_false_reject_risk: risk(rules.reject) };
  const limits: Record<string, LimitPair> = {};
  for (const row of rows) {
    const [lower, upper] = [typed(row.lower), typed(row.upper)];
    if (lower === null && upper === null) continue;
    limits[row.quantity] = { ...(lower === null ? {} : { lower }), ...(upper === null ? {} : { upper }) };
  }
  if (Object.keys(limits).length === 0) return null;
  return {
    name: name.trim() === '' ? 'limits of the page' : name.trim(),
    limits,
    ...(decision.max_false_accept_risk === RISK && decision.max_false_reject_risk === RISK ? {} : { decision }),
    ...(rules.plane === '' ? {} : { reference_plane: rules.plane }),
  };
}

/** The limits in one line: `θr 9 … 11° · ρd ≥ 0.25 · accepted risks 2.5 %`. */
export function limitsWords(specification: Specification): string {
  const order: readonly string[] = QUANTITIES;
  const rank = (quantity: string): number => (order.includes(quantity) ? order.indexOf(quantity) : order.length);
  const parts = Object.entries(specification.limits)
    .sort(([a], [b]) => rank(a) - rank(b))
    .map(([quantity, { lower, upper }]) => {
      const { symbol, unit } = WORDS[quantity] ?? { symbol: quantity, unit: '' };
      const range = lower == null ? `≤ ${plain(upper ?? Number.NaN, 6)}` : upper == null ? `≥ ${plain(lower, 6)}` : `${plain(lower, 6)} … ${plain(upper, 6)}`;
      return `${symbol.replace('_', '')} ${range}${unit}`;
    });
  const { accept, reject } = rulesOf(specification);
  return [...parts, accept === reject ? `accepted risks ${accept} %` : `accepted risks ${accept} % (pass), ${reject} % (fail)`].join(' · ');
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
