// What a fit may be asked beyond its model: how outliers count, what is known beforehand, further intervals.

import { sentence } from './api';
import { typed } from './limits';
import type { FitAsked } from './types';
import { PARAMETERS, VARIANTS, type ParameterWords } from './words';
import { plain } from './format';

export const LOSSES: Readonly<Record<string, string>> = {
  linear: 'count in full (least squares)',
  huber: 'count less (Huber)',
  tukey: 'do not count (Tukey)',
};

/** What can be known beforehand: the parameters of the report, and the index of refraction. */
export const KNOWABLE: Readonly<Record<string, ParameterWords>> = {
  ...PARAMETERS,
  eta: { symbol: 'n', name: 'refractive index', unit: '' },
  k: { symbol: 'κ', name: 'extinction coefficient of a metal', unit: '' },
};

/** One thing known beforehand, as a person types it; without an uncertainty the parameter is held. */
export interface KnownRow {
  parameter: string;
  value: string;
  std: string;
}

export interface FitChoices {
  readonly loss: string;
  readonly judge: boolean;
  readonly profile: boolean;
  readonly known: readonly KnownRow[];
}

/** The part of `POST /fits` that choices make; what stands at its default stays out. */
export interface FitOptions {
  readonly loss?: string;
  readonly judge?: true;
  readonly profile?: true;
  readonly fix?: Readonly<Record<string, number>>;
  readonly priors?: Readonly<Record<string, { readonly value: number; readonly std: number }>>;
}

/** What is wrong with a row, or null. A row without anything typed is none. */
export function knownProblem(row: KnownRow, rows: readonly KnownRow[]): string | null {
  const [value, std] = [typed(row.value), typed(row.std)];
  if (value === null && std === null) return null;
  if (value === null || Number.isNaN(value)) return 'give its value as a number';
  if (std !== null && !(std > 0)) return 'its standard uncertainty is a number above 0; without one the value is held';
  if (rows.filter((r) => r.parameter === row.parameter && typed(r.value) !== null).length > 1) return 'is there twice';
  return null;
}

/** What the daemon has against an option, its parameters by the names that the form has for them. */
export function refusedWords(said: string): string {
  const named = said.replace(/^(fix|priors)(\.\w+)?: /i, (_, _list: string, field?: string) => (field === undefined ? '' : `The ${KNOWABLE[field.slice(1)]?.name ?? field.slice(1)}: `));
  // A single letter may be a word of the sentence.
  const names = Object.entries(KNOWABLE).filter(([key]) => key.length > 1);
  const told = names.reduce((text, [key, { name }]) => text.replace(new RegExp(`\\b${key}\\b`, 'g'), key === 'scale' ? key : name), named);
  return sentence(told.replace(/^The ([^:]+): \1 /, 'The $1 '));
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

/** What was asked of a fit, in words: `model best`, `judged by the ray tracer`, `ρ_d held at 0.3`. */
export function askedWords(asked: FitAsked): string[] {
  const words: string[] = [`model ${VARIANTS[asked.variant ?? 'auto']?.name ?? asked.variant}`];
  // A line of text has no subscripts.
  const what = (name: string): string => (KNOWABLE[name]?.symbol ?? name).replace('_', '');
  const unit = (name: string): string => KNOWABLE[name]?.unit ?? '';
  if (asked.region != null) words.push(`region ${asked.region}`);
  if (asked.judge === true) words.push('checked with the ray tracer');
  if (asked.loss != null && asked.loss !== 'linear') words.push(`outliers ${LOSSES[asked.loss] ?? asked.loss}`);
  for (const [name, value] of Object.entries(asked.fix ?? {})) words.push(`${what(name)} held at ${plain(value, 6)}${unit(name)}`);
  for (const [name, p] of Object.entries(asked.priors ?? {})) words.push(`${what(name)} known as ${plain(p.value, 6)} ± ${plain(p.std, 3)}${unit(name)}`);
  if (asked.profile === true) words.push('profile intervals');
  if (asked.bootstrap != null && asked.bootstrap > 0) words.push(`bootstrap of ${asked.bootstrap} series`);
  if (asked.starts != null) words.push(asked.starts === 1 ? 'one start' : `${asked.starts} starts`);
  if (asked.tolerance != null) words.push(`left out what costs less than ${plain(100 * asked.tolerance)} % of the peak`);
  if (asked.max_seconds != null) words.push(`at most ${plain(asked.max_seconds)} s`);
  if (asked.target_error != null) words.push(`tracer’s error below ${plain(100 * asked.target_error)} %`);
  if (asked.shape?.name != null) words.push(`on the shape in ${asked.shape.name}`);
  return words;
}
