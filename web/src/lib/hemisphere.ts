// Direction bins of a trace: their numbers, quantities derived from them, and their places on a disc.
//
// A disc shows the directions of exit from above: the polar angle grows linearly from the centre to the rim, +u is to the
// right, +v upwards. Stokes vectors are referred to s and p of the beam, as in the daemon.

import type { Palette } from './perceptual';
import type { TraceResult } from './types';

export type Side = 'reflected' | 'transmitted';
export type Stokes = readonly [number, number, number, number];

/** Values over the bins of one side with their standard errors; NaN where there is no value. */
export interface Field {
  readonly values: Float32Array;
  readonly stds: Float32Array;
}

/** The numbers of `bins.f32`. */
export class Bins {
  readonly nTheta: number;
  readonly nPhi: number;
  readonly sides: readonly string[];
  readonly names: readonly string[];
  readonly #block: Float32Array;

  /** Throws if the block does not have the length that the trace states. */
  constructor(of: TraceResult['bins'], bytes: ArrayBuffer) {
    this.nTheta = of.n_theta;
    this.nPhi = of.n_phi;
    this.sides = of.sides;
    this.names = of.numbers;
    if (bytes.byteLength !== 8 * this.perSide * of.sides.length * of.numbers.length) throw new Error('the file of bins is damaged');
    this.#block = new Float32Array(bytes);
  }

  get perSide(): number {
    return this.nTheta * this.nPhi;
  }

  get polarised(): boolean {
    return this.names.length >= 16;
  }

  /** One number of all bins of a side. */
  field(side: Side, name: string): Field {
    const [at, n, i] = [this.sides.indexOf(side), this.names.length, this.names.indexOf(name)];
    const [values, stds] = [new Float32Array(this.perSide).fill(Number.NaN), new Float32Array(this.perSide).fill(Number.NaN)];
    if (at < 0 || i < 0) return { values, stds };
    for (let bin = 0; bin < this.perSide; bin++) {
      const place = 2 * ((at * this.perSide + bin) * n + i);
      values[bin] = this.#block[place] ?? Number.NaN;
      stds[bin] = this.#block[place + 1] ?? Number.NaN;
    }
    return { values, stds };
  }
}

export const MUELLER: readonly string[] = Array.from({ length: 16 }, (_, i) => `m${Math.floor(i / 4)}${i % 4}`);

/** A Stokes component (0 to 3) of the outgoing light for the lamp's state. Errors of the elements are assumed independent. */
export function stokesField(bins: Bins, side: Side, component: number, lamp: Stokes): Field {
  const row = [0, 1, 2, 3].map((j) => bins.field(side, `m${component}${j}`));
  const first = row[0];
  if (!first) throw new Error('a row has four elements');
  const [values, stds] = [new Float32Array(first.values), new Float32Array(first.stds)];
  for (let bin = 0; bin < values.length; bin++) {
    let [sum, square] = [0, 0];
    row.forEach((element, j) => {
      sum += (element.values[bin] ?? 0) * (lamp[j] ?? 0);
      square += ((element.stds[bin] ?? 0) * (lamp[j] ?? 0)) ** 2;
    });
    values[bin] = sum;
    stds[bin] = Math.sqrt(square);
  }
  return { values, stds };
}

/** Ratios are shown where the relative error of the denominator is below this. */
const SETTLED = 0.3;

/** One field divided by another, with the error of the numerator. NaN where the denominator is noise. */
export function ratioField(above: Field, below: Field): Field {
  const values = above.values.map((x, bin) => (settled(below, bin) ? x / (below.values[bin] ?? Number.NaN) : Number.NaN));
  const stds = above.stds.map((x, bin) => x / (below.values[bin] ?? Number.NaN));
  return { values, stds };
}

function settled(field: Field, bin: number): boolean {
  const [value, std] = [field.values[bin] ?? Number.NaN, field.stds[bin] ?? Number.NaN];
  return value > 0 && std <= SETTLED * value;
}

/** Degree of linear polarisation. */
export function dolpField(i: Field, q: Field, u: Field): Field {
  const noise = i.values.map((x, bin) => Math.hypot(q.stds[bin] ?? 0, u.stds[bin] ?? 0) / x);
  const values = i.values.map((x, bin) => (settled(i, bin) ? Math.hypot(q.values[bin] ?? 0, u.values[bin] ?? 0) / x : Number.NaN));
  return { values, stds: noise };
}

/** Angle of polarisation, degrees from s to p; NaN where the light is nearly unpolarised. */
export function aopField(i: Field, q: Field, u: Field): Field {
  const dolp = dolpField(i, q, u);
  const means = (bin: number): boolean => (dolp.values[bin] ?? 0) > Math.max(0.01, 2 * (dolp.stds[bin] ?? 0));
  const values = i.values.map((_, bin) => (means(bin) ? (90 / Math.PI) * Math.atan2(u.values[bin] ?? 0, q.values[bin] ?? 0) : Number.NaN));
  const stds = i.values.map((_, bin) => (90 / Math.PI) * ((dolp.stds[bin] ?? 0) / (dolp.values[bin] ?? Number.NaN)));
  return { values, stds };
}

/** The four numbers of `difference.f32`; the second pair has no errors. */
export function differenceFields(bytes: ArrayBuffer): Record<'mean' | 'adm' | 'mdm', Field> {
  const block = new Float32Array(bytes);
  const column = (i: number): Float32Array => Float32Array.from({ length: block.length / 4 }, (_, bin) => block[4 * bin + i] ?? Number.NaN);
  const std = column(1);
  return { mean: { values: column(0), stds: std }, adm: { values: column(2), stds: std }, mdm: { values: column(3), stds: std } };
}

/** Maps values to colours. */
export interface Scale {
  readonly kind: 'log' | 'linear';
  /** Values run from −top to top, from 0 (logarithmic: bottom) to top, or cyclically from −top to top. */
  readonly palette: Palette;
  readonly top: number;
  /** Lower end of an unsigned logarithmic scale. */
  readonly bottom?: number;
}

/** Decades on either side of zero that a signed logarithmic scale resolves. */
const DECADES = 3;

/** Position of a value on a scale, 0 to 1; beyond 1 if it is too large. */
export function placeOn(scale: Scale, x: number): number {
  const share = x / scale.top;
  if (scale.palette === 'sequential') {
    const { bottom = 0 } = scale;
    return scale.kind === 'log' && bottom > 0 ? Math.log(Math.max(x, bottom) / bottom) / Math.log(scale.top / bottom) : share;
  }
  if (scale.kind === 'linear') return 0.5 + 0.5 * share;
  // Linear about zero, logarithmic beyond a thousandth of the top.
  const grown = Math.asinh(Math.abs(share) * 0.5 * 10 ** DECADES) / Math.asinh(0.5 * 10 ** DECADES);
  return 0.5 + 0.5 * Math.sign(share) * grown;
}

/** Values of the marks on the colour bar. */
export function marksOf(scale: Scale): number[] {
  const { top } = scale;
  if (scale.palette === 'sequential' && scale.kind === 'log' && scale.bottom !== undefined) {
    const decades = Math.round(Math.log10(top / scale.bottom));
    return Array.from({ length: decades + 1 }, (_, i) => Number((top / 10 ** i).toPrecision(6))).reverse();
  }
  if (scale.palette === 'sequential') return [0, 0.5 * top, top];
  if (scale.palette === 'cyclic') return [-90, -45, 0, 45, 90];
  if (scale.kind === 'linear') return [-top, -0.5 * top, 0, 0.5 * top, top];
  const powers = [top, top / 10, top / 100];
  return [...powers.map((x) => -x), 0, ...powers.toReversed()];
}

/** The next power of ten. */
export function decadeAbove(x: number): number {
  return x > 0 && Number.isFinite(x) ? 10 ** Math.ceil(Math.log10(x) - 1e-9) : 1;
}

/** The next of 1, 2, 3 and 5 times the powers of ten. */
export function roundAbove(x: number): number {
  const power = decadeAbove(x) / 10;
  return power * ([1, 2, 3, 5, 10].find((step) => step * power >= x * (1 - 1e-9)) ?? 10);
}

/** Greatest absolute value above noise; 0 if there is none. */
export function greatest(field: Field): number {
  let most = 0;
  field.values.forEach((x, bin) => {
    if (Math.abs(x) > 2 * (field.stds[bin] ?? 0)) most = Math.max(most, Math.abs(x));
  });
  return most;
}

/** A scale for non-negative values, from the lowest decade with light to the greatest value, with at most as many decades as the bar has room for. */
export function brightnessScale(fields: readonly Field[], kind: Scale['kind']): Scale {
  const most = Math.max(...fields.map(greatest));
  if (kind === 'linear') return { kind, palette: 'sequential', top: roundAbove(most) };
  const top = decadeAbove(most);
  let least = top;
  for (const field of fields) {
    field.values.forEach((x, bin) => {
      if (x > 2 * (field.stds[bin] ?? 0)) least = Math.min(least, x);
    });
  }
  const bottom = Math.max(decadeAbove(least) / (decadeAbove(least) > least ? 10 : 1), top / 10 ** BRIGHTNESS_DECADES);
  return { kind, palette: 'sequential', top, bottom: Math.min(bottom, top / 10) };
}

/** Decades of brightness that the scale resolves. */
const BRIGHTNESS_DECADES = 6;

/** The bin at a place of the unit disc, y upwards; null beyond its rim. */
export function binAt(x: number, y: number, nTheta: number, nPhi: number): number | null {
  const r = Math.hypot(x, y);
  if (r >= 1) return null;
  const turn = Math.atan2(y, x) / (2 * Math.PI);
  const column = Math.min(nPhi - 1, Math.floor((turn < 0 ? turn + 1 : turn) * nPhi));
  return Math.min(nTheta - 1, Math.floor(r * nTheta)) * nPhi + column;
}

/** The middle of a bin, degrees. */
export function middleOf(bin: number, nTheta: number, nPhi: number): { theta_deg: number; phi_deg: number } {
  return { theta_deg: (90 * (Math.floor(bin / nPhi) + 0.5)) / nTheta, phi_deg: (360 * ((bin % nPhi) + 0.5)) / nPhi };
}

/** Position of a direction on the unit disc, y upwards. */
export function placeOf(thetaDeg: number, phiDeg: number): { x: number; y: number } {
  const phi = (phiDeg * Math.PI) / 180;
  return { x: (thetaDeg / 90) * Math.cos(phi), y: (thetaDeg / 90) * Math.sin(phi) };
}
