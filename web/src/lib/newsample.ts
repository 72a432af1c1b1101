// A new part as typed: name and material, and what is wrong with either.

import { typed } from './typed';
import type { Material } from './types';

export const MATERIALS = {
  dielectric: 'plastic, glass (index n)',
  metal: 'metal, by name',
  conductor: 'metal, by n and κ',
} as const;
export type MaterialChoice = keyof typeof MATERIALS;

/** Metals in the daemon's tables. */
export const METALS: Readonly<Record<string, string>> = { Ag: 'silver', Al: 'aluminium', Au: 'gold', Cr: 'chromium', Cu: 'copper', W: 'tungsten' };

/** Fields as typed; those that the chosen material does not have are ignored. */
export interface SampleFields {
  readonly name: string;
  readonly material: MaterialChoice;
  readonly eta: string;
  readonly etaStd: string;
  readonly k: string;
  readonly kStd: string;
  readonly metal: string;
  readonly wavelength: string;
}
export type FieldName = 'name' | 'eta' | 'k' | 'metal' | 'wavelength';

/** The body of `POST /samples`. */
export interface SampleRequest {
  readonly name: string;
  readonly material?: Material;
  readonly metal?: { readonly name: string; readonly wavelength_nm?: number };
}

const NAME_MAX = 200;
/** The daemon's bounds of an index (n of a plastic, n and k of a metal) and of a wavelength, nm. */
const BOUNDS = { dielectric: [1.0001, 10], conductor: [0.01, 100], k: [0, 50], wavelength: [100, 1e5] } as const;

/** What is wrong with a value and its standard uncertainty, or null. */
function pairProblem(value: string, std: string, [low, high]: readonly [number, number]): string | null {
  const [x, u] = [typed(value), typed(std)];
  if (x === null) return 'give a number';
  if (Number.isNaN(x)) return `“${value.trim()}” is not a number`;
  if (x < low || x > high) return `must be from ${low} to ${high}`;
  if (u === null) return 'give its standard uncertainty, 0 if it is exact';
  if (Number.isNaN(u)) return `“${std.trim()}” is not a number`;
  return u < 0 || u > BOUNDS.k[1] ? `its standard uncertainty must be from 0 to ${BOUNDS.k[1]}` : null;
}

/** What is wrong with the part, by field; empty if it can be added. */
export function sampleProblems(fields: SampleFields): Partial<Record<FieldName, string>> {
  const found: Partial<Record<FieldName, string>> = {};
  const name = fields.name.trim();
  if (name === '') found.name = 'give a name';
  else if ([...name].length > NAME_MAX) found.name = `at most ${NAME_MAX} characters`;
  if (fields.material === 'metal') {
    const nm = typed(fields.wavelength);
    const [low, high] = BOUNDS.wavelength;
    if (nm !== null && !(nm >= low && nm <= high)) found.wavelength = `must be from ${low} to ${high} nm, or empty for the lamp’s wavelength`;
    return found;
  }
  const eta = pairProblem(fields.eta, fields.etaStd, BOUNDS[fields.material]);
  if (eta !== null) found.eta = eta;
  const k = fields.material === 'conductor' ? pairProblem(fields.k, fields.kStd, BOUNDS.k) : null;
  if (k !== null) found.k = k;
  return found;
}

/** The request for the part of the fields, which must have no problem. */
export function sampleRequest(fields: SampleFields): SampleRequest {
  const number = (text: string): number => typed(text) ?? Number.NaN;
  const name = fields.name.trim();
  const [eta, eta_std] = [number(fields.eta), number(fields.etaStd)];
  if (fields.material === 'dielectric') return { name, material: { kind: 'dielectric', eta, eta_std } };
  if (fields.material === 'conductor') return { name, material: { kind: 'conductor', eta, eta_std, k: number(fields.k), k_std: number(fields.kStd) } };
  const nm = typed(fields.wavelength);
  return { name, metal: { name: fields.metal, ...(nm === null ? {} : { wavelength_nm: nm }) } };
}
