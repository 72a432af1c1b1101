// Statistics of a map's values: colour range, histogram, regions, and the share of pixels within limits.

import { judged, type Risks } from './conformity';
import type { Raster } from './tiff';
import type { LimitPair, VerdictWord } from './types';

export interface Range {
  readonly from: number;
  readonly to: number;
}

/** The values of the pixels that have one, ascending. */
export function sortedValues(values: Float32Array): Float32Array {
  return values.filter((x) => Number.isFinite(x)).sort();
}

/** Quantile between the two nearest of some ascending values; NaN of none. */
export function quantile(sorted: Float32Array | Float64Array | readonly number[], share: number): number {
  const at = share * (sorted.length - 1);
  const low = sorted[Math.floor(at)] ?? Number.NaN;
  const high = sorted[Math.ceil(at)] ?? Number.NaN;
  return low + (at - Math.floor(at)) * (high - low);
}

/** A range with room where all values are the same. */
function widened(from: number, to: number): Range {
  if (!Number.isFinite(from) || !Number.isFinite(to)) return { from: 0, to: 1 };
  const half = Math.max(0.05 * Math.abs(from), 1e-6);
  return to - from > 1e-9 * Math.abs(from) ? { from, to } : { from: from - half, to: to + half };
}

/** 1st to 99th percentile: a few defects do not widen it. */
export const usualRange = (sorted: Float32Array): Range => widened(quantile(sorted, 0.01), quantile(sorted, 0.99));

export const wholeRange = (sorted: Float32Array): Range => widened(sorted[0] ?? Number.NaN, sorted.at(-1) ?? Number.NaN);

/** The axis of the histogram: the colour range, and around the usual one half of its width. */
export function axisOf(sorted: Float32Array, { from, to }: Range): Range {
  const [usual, whole] = [usualRange(sorted), wholeRange(sorted)];
  const room = 0.5 * (usual.to - usual.from);
  return { from: Math.min(from, Math.max(whole.from, usual.from - room)), to: Math.max(to, Math.min(whole.to, usual.to + room)) };
}

/** Pixels per bin of equal width; values outside the range are not counted, its upper end is in the last bin. */
export function histogram(values: Float32Array | readonly number[], { from, to }: Range, bins: number): number[] {
  const counts = new Array<number>(bins).fill(0);
  for (const x of values) {
    if (!(x >= from && x <= to)) continue;
    const bin = Math.min(bins - 1, Math.floor(((x - from) / (to - from)) * bins));
    counts[bin] = (counts[bin] ?? 0) + 1;
  }
  return counts;
}

/** A rectangle of pixels; its last column and row belong to it. */
export interface Region {
  readonly left: number;
  readonly top: number;
  readonly right: number;
  readonly bottom: number;
}

/** The rectangle between two pixels, within the map. */
export function regionOf(a: { readonly x: number; readonly y: number }, b: { readonly x: number; readonly y: number }, { width, height }: Raster): Region {
  const within = (x: number, n: number): number => Math.min(n - 1, Math.max(0, Math.round(x)));
  const [ax, bx, ay, by] = [within(a.x, width), within(b.x, width), within(a.y, height), within(b.y, height)];
  return { left: Math.min(ax, bx), top: Math.min(ay, by), right: Math.max(ax, bx), bottom: Math.max(ay, by) };
}

/** The values of a region, without pixels that have none. */
export function valuesIn({ width, values }: Raster, region: Region): number[] {
  const found: number[] = [];
  for (let y = region.top; y <= region.bottom; y++) {
    for (let x = region.left; x <= region.right; x++) {
      const value = values[y * width + x] ?? Number.NaN;
      if (Number.isFinite(value)) found.push(value);
    }
  }
  return found;
}

export interface Summary {
  readonly n: number;
  readonly mean: number;
  /** Standard deviation of a pixel, N − 1 in the denominator; null of one pixel. */
  readonly deviation: number | null;
  readonly p5: number;
  readonly median: number;
  readonly p95: number;
}

/** The direction within 180° of another one. */
const near = (deg: number, centre: number): number => centre + ((((deg - centre + 180) % 360) + 360) % 360) - 180;

function meanDirection(values: Float64Array): number {
  const sum = (f: (rad: number) => number): number => values.reduce((s, deg) => s + f((deg * Math.PI) / 180), 0);
  return (Math.atan2(sum(Math.sin), sum(Math.cos)) * 180) / Math.PI;
}

/** Statistics of some values; directions in degrees are counted around their mean direction. Null of none. */
export function summaryOf(values: Float32Array | readonly number[], directions = false): Summary | null {
  const n = values.length;
  if (n === 0) return null;
  const sorted = Float64Array.from(values);
  if (directions) {
    const centre = meanDirection(sorted);
    sorted.forEach((deg, i) => (sorted[i] = near(deg, centre)));
  }
  sorted.sort();
  let sum = 0;
  for (const x of sorted) sum += x;
  const mean = sum / n;
  let square = 0;
  for (const x of sorted) square += (x - mean) ** 2;
  const back = (x: number): number => (directions ? near(x, 0) : x);
  return { n, mean: back(mean), deviation: n < 2 ? null : Math.sqrt(square / (n - 1)), p5: back(quantile(sorted, 0.05)), median: back(quantile(sorted, 0.5)), p95: back(quantile(sorted, 0.95)) };
}

/** Standard uncertainty of a pixel: its own noise and what all pixels have in common. */
export const stdOf = (own: number, shared: number | null | undefined): number => Math.hypot(own, shared ?? 0);

/** What a pixel is, as a number in a list of pixels. */
export const CLASSES: readonly ('none' | VerdictWord)[] = ['none', 'pass', 'fail', 'cannot-tell'];

/** Judges each pixel by itself. */
export function judgedPixels(values: Float32Array, std: Float32Array, shared: number | null | undefined, limits: LimitPair, risks: Risks): Uint8Array {
  const classes = new Uint8Array(values.length);
  values.forEach((value, i) => {
    const u = stdOf(std[i] ?? Number.NaN, shared);
    if (Number.isFinite(value) && Number.isFinite(u)) classes[i] = CLASSES.indexOf(judged(value, u, limits, risks));
  });
  return classes;
}

export type Shares = Readonly<Record<VerdictWord, number>> & { readonly n: number };

/** Shares of the judged pixels, of a region or of the whole map. */
export function sharesOf(classes: Uint8Array, width: number, region: Region | null): Shares {
  const counts = [0, 0, 0, 0];
  classes.forEach((of, i) => {
    const [x, y] = [i % width, Math.floor(i / width)];
    if (region === null || (x >= region.left && x <= region.right && y >= region.top && y <= region.bottom)) counts[of] = (counts[of] ?? 0) + 1;
  });
  const [, pass = 0, fail = 0, cannot = 0] = counts;
  const n = pass + fail + cannot;
  return { n, pass: pass / n, fail: fail / n, 'cannot-tell': cannot / n };
}
