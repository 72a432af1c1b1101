// Options of a fit beyond its model: the loss for outliers, known values, further intervals.

import { typed } from './typed';
import type { FitAsked } from './types';
import { KNOWABLE, VARIANTS } from './words';
import { plain } from './format';

export const LOSSES: Readonly<Record<string, string>> = {
  linear: 'count in full (least squares)',
  huber: 'count less (Huber)',
  tukey: 'do not count (Tukey)',
};

/** One known value as typed. Without an uncertainty, the parameter is fixed at it. */
export interface KnownRow {
  parameter: string;
  value: string;
  std: string;
}

interface FitChoices {
  readonly loss: string;
  readonly judge: boolean;
  readonly profile: boolean;
  readonly known: readonly KnownRow[];
}

/** The part of `POST /fits` that the options make. Defaults are omitted. */
export interface FitOptions {
  readonly loss?: string;
  readonly judge?: true;
  readonly profile?: true;
  readonly fix?: Readonly<Record<string, number>>;
  readonly priors?: Readonly<Record<string, { readonly value: number; readonly std: number }>>;
}

/** What is wrong with a row, or null. An empty row is valid. */
export function knownProblem(row: KnownRow, rows: readonly KnownRow[]): string | null {
  const [value, std] = [typed(row.value), typed(row.std)];
  if (value === null && std === null) return null;
  if (value === null || Number.isNaN(value)) return 'give its value as a number';
  if (std !== null && !(std > 0)) return 'its standard uncertainty must be a number above 0; leave it empty to fix the value';
  if (rows.filter((r) => r.parameter === row.parameter && typed(r.value) !== null).length > 1) return 'is given twice';
  return null;
}

export function optionsOf(choices: FitChoices): FitOptions {
  const fix: Record<string, number> = {};
  const priors: Record<string, { value: number; std: number }> = {};
  for (const row of choices.known) {
    const [value, std] = [typed(row.value), typed(row.std)];
    if (value === null) continue;
    if (std === null) fix[row.parameter] = value;
    else priors[row.parameter] = { value, std };
  }
  return {
    ...(choices.loss === 'linear' ? {} : { loss: choices.loss }),
    ...(choices.judge ? { judge: true } : {}),
    ...(choices.profile ? { profile: true } : {}),
    ...(Object.keys(fix).length > 0 ? { fix } : {}),
    ...(Object.keys(priors).length > 0 ? { priors } : {}),
  };
}

/** The request of a fit in words: `model best`, `checked with the ray tracer`, `ρ_d fixed at 0.3`. */
export function askedWords(asked: FitAsked): string[] {
  const words: string[] = [`model ${VARIANTS[asked.variant ?? 'auto']?.name ?? asked.variant}`];
  // Plain text has no subscripts.
  const what = (name: string): string => (KNOWABLE[name]?.symbol ?? name).replace('_', '');
  const unit = (name: string): string => KNOWABLE[name]?.unit ?? '';
  if (asked.region != null) words.push(`region ${asked.region}`);
  if (asked.judge === true) words.push('checked with the ray tracer');
  if (asked.loss != null && asked.loss !== 'linear') words.push(`outliers ${LOSSES[asked.loss] ?? asked.loss}`);
  for (const [name, value] of Object.entries(asked.fix ?? {})) words.push(`${what(name)} fixed at ${plain(value, 6)}${unit(name)}`);
  for (const [name, p] of Object.entries(asked.priors ?? {})) words.push(`${what(name)} known as ${plain(p.value, 6)}${unit(name)} (u = ${plain(p.std, 3)}${unit(name)})`);
  if (asked.profile === true) words.push('profile intervals');
  if (asked.bootstrap != null && asked.bootstrap > 0) words.push(`bootstrap of ${asked.bootstrap} series`);
  if (asked.starts != null) words.push(asked.starts === 1 ? 'one start' : `${asked.starts} starts`);
  if (asked.tolerance != null) words.push(`terms below ${plain(100 * asked.tolerance)} % of the peak left out`);
  if (asked.max_seconds != null) words.push(`time limit ${plain(asked.max_seconds)} s`);
  if (asked.target_error != null) words.push(`tracer’s error below ${plain(100 * asked.target_error)} %`);
  if (asked.shape?.name != null) words.push(`on the shape in ${asked.shape.name}`);
  return words;
}
