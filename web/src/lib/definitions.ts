// Versions of recipes and specifications: what changed between two of them, in words; and which field a refusal belongs to.

import { faultWords, sentence, type FieldProblem } from './problems';
import type { StoredDefinition } from './types';
import { KNOWABLE, QUANTITIES } from './words';

/** The content of a version. */
export const contentOf = (stored: StoredDefinition): object => ('recipe' in stored ? stored.recipe : stored.specification);

export interface Change {
  readonly what: string;
  /** Null: it was not stated. */
  readonly before: string | null;
  /** Null: it is no longer stated. */
  readonly after: string | null;
}

const NAMES: Readonly<Record<string, string>> = {
  note: 'note',
  target_expanded_deg: 'target U(θr), °',
  'plan.preset': 'grid',
  'plan.theta_c_deg': 'camera tilts, °',
  'plan.phi_s_deg': 'sample azimuths, °',
  'plan.poses': 'poses one by one',
  'plan.exposures_s': 'exposures, s',
  'plan.repeats': 'repeats',
  'plan.dark.repeats': 'dark frames per exposure',
  'plan.flat.theta_c_deg': 'white reference: camera tilts, °',
  'plan.flat.exposures_s': 'white reference: exposures, s',
  'plan.flat.repeats': 'white reference: frames per tilt and exposure',
  'plan.reuse_calibrations': 'earlier calibrations are used',
  'plan.reference_every': 'points between two reference poses',
  'fit.variant': 'model',
  'fit.loss': 'outliers',
  'fit.judge': 'check with the ray tracer',
  'fit.profile': 'profile intervals',
  'fit.region': 'region',
  'fit.bootstrap': 'bootstrap series',
  'fit.starts': 'starts of a search',
  'fit.max_seconds': 'time limit of the fit, s',
  'fit.target_error': 'tracer’s error',
  'fit.tolerance': 'terms left out below',
  'material.eta': 'index n',
  'material.eta_std': 'standard uncertainty of n',
  'material.k': 'extinction coefficient κ',
  'material.k_std': 'standard uncertainty of κ',
  'decision.max_false_accept_risk': 'risk of passing a bad part',
  'decision.max_false_reject_risk': 'risk of failing a good part',
  reference_plane: 'plane of the angles',
};

function nameOf(path: string): string {
  const known = NAMES[path];
  if (known !== undefined) return known;
  const [head, key = '', last = ''] = path.startsWith('fit.') ? path.split('.').slice(1) : path.split('.');
  if (head === 'limits') return `${QUANTITIES[key]?.name ?? key}: ${last} limit`;
  if (head === 'fix') return `${KNOWABLE[key]?.name ?? key}: fixed at`;
  if (head === 'priors') return `${KNOWABLE[key]?.name ?? key}: known ${last === 'std' ? 'standard uncertainty' : 'value'}`;
  return path.replaceAll(/[._]/g, ' ');
}

/** Every stated value as text, by its path. */
function stated(value: unknown, path: string, into: Map<string, string>): Map<string, string> {
  if (value === null || value === undefined) return into;
  if (Array.isArray(value)) return into.set(path, value.join(', '));
  if (typeof value !== 'object') return into.set(path, value === true ? 'yes' : value === false ? 'no' : String(value));
  const { from, to, step } = value as Readonly<Record<string, unknown>>;
  if (from !== undefined && to !== undefined) return into.set(path, `${String(from)}:${String(step)}:${String(to)}`);
  for (const [key, part] of Object.entries(value)) stated(part, path === '' ? key : `${path}.${key}`, into);
  return into;
}

/** Values that differ, in the order of the later content, then those that are gone. */
export function changesBetween(before: object, after: object): Change[] {
  const [old, now] = [stated(before, '', new Map()), stated(after, '', new Map())];
  const paths = [...now.keys(), ...[...old.keys()].filter((path) => !now.has(path))];
  return paths.filter((path) => old.get(path) !== now.get(path)).map((path) => ({ what: nameOf(path), before: old.get(path) ?? null, after: now.get(path) ?? null }));
}

/** A change as text: `repeats: 1 → 2`. */
export const changeWords = ({ what, before, after }: Change): string => `${what}: ${before ?? 'not stated'} → ${after ?? 'not stated'}`;

/** Refusals by the fields of a form, which are paths of the content; those of no field under the empty name. */
export function refusalsAt(errors: readonly FieldProblem[], fields: readonly string[]): Record<string, string> {
  const found = new Map<string, FieldProblem[]>();
  for (const error of errors) {
    const path = error.field.replaceAll(/\[\d+\]/g, '').replace(/^(recipe|specification)\./, '');
    const place = fields.filter((f) => path === f || path.startsWith(`${f}.`) || path.startsWith(`${f}_`)).sort((a, b) => b.length - a.length)[0] ?? '';
    found.set(place, [...(found.get(place) ?? []), error]);
  }
  const words = (place: string, list: readonly FieldProblem[]): string =>
    place === '' || list.some((e) => e.out_of_range) ? faultWords(list) : [...new Set(list.map((e) => sentence(e.message)))].join(' ');
  return Object.fromEntries([...found].map(([place, list]) => [place, words(place, list)]));
}
