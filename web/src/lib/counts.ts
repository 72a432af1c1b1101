// Statistics of a frame's counts, and the painting of counts as colours.

import { colourMap, SATURATED_RGB, type ColourMapName } from './colourmap';
import type { Frame16 } from './png16';

export interface CountStatistics {
  readonly min: number;
  readonly max: number;
  readonly mean: number;
  readonly median: number;
  /** Pixels at or above saturation. */
  readonly saturated: number;
  /** Pixels of each count from 0 to 65535. */
  readonly counts: Uint32Array;
  /** Levels that hide the lowest and the highest 0.2 % of the pixels. */
  readonly autoLow: number;
  readonly autoHigh: number;
}

const HISTOGRAM_BINS = 256;

/** Both ends of the axis of a histogram, DN; the upper one is not included. */
interface CountRange {
  readonly from: number;
  readonly to: number;
}

export const WHOLE_RANGE: CountRange = { from: 0, to: 65536 };

/** The range of nearly all pixels with a margin: a few defect pixels do not widen it. */
export function usedRange(statistics: CountStatistics): CountRange {
  const span = Math.max(statistics.autoHigh - statistics.autoLow, 16);
  const from = Math.max(0, Math.floor(statistics.autoLow - 0.5 * span));
  return { from, to: Math.min(65536, Math.ceil(statistics.autoHigh + 0.5 * span) + 1) };
}

/** Pixels per bin of equal width over a range; a narrow range has one bin per count. */
export function binned(counts: Uint32Array, { from, to }: CountRange): Uint32Array {
  const bins = new Uint32Array(Math.min(HISTOGRAM_BINS, to - from));
  for (let dn = from; dn < to; dn++) {
    const bin = Math.floor(((dn - from) * bins.length) / (to - from));
    bins[bin] = (bins[bin] ?? 0) + (counts[dn] ?? 0);
  }
  return bins;
}

export function countStatistics(frame: Frame16, saturationDn: number): CountStatistics {
  const counts = new Uint32Array(65536);
  for (const dn of frame.pixels) counts[dn] = (counts[dn] ?? 0) + 1;
  const total = frame.pixels.length;
  let min = -1;
  let max = 0;
  let sum = 0;
  let saturated = 0;
  let seen = 0;
  const quantiles = [0.002, 0.5, 0.998];
  const levels = [0, 0, 0];
  for (let dn = 0; dn < 65536; dn++) {
    const n = counts[dn] ?? 0;
    if (n === 0) continue;
    if (min < 0) min = dn;
    max = dn;
    sum += n * dn;
    if (dn >= saturationDn) saturated += n;
    const before = seen;
    seen += n;
    quantiles.forEach((q, i) => {
      if (before < q * total && seen >= q * total) levels[i] = dn;
    });
  }
  const [low = 0, median = 0, high = 0] = levels;
  return {
    min: Math.max(min, 0),
    max,
    mean: sum / total,
    median,
    saturated,
    counts,
    autoLow: low,
    autoHigh: Math.max(high, low + 1),
  };
}

export interface Levels {
  /** Count of the darkest colour. */
  readonly low: number;
  /** Count of the brightest colour. */
  readonly high: number;
  readonly scale: 'linear' | 'log';
}

/** Position of a count between the levels, 0 to 1. Logarithmic: decades above the low level, with steps of at least one count. */
export function levelFraction(dn: number, levels: Levels): number {
  const span = Math.max(levels.high - levels.low, 1);
  const t = levels.scale === 'log' ? Math.log1p(Math.max(dn - levels.low, 0)) / Math.log1p(span) : (dn - levels.low) / span;
  return Math.min(1, Math.max(0, t));
}

/** RGBA bytes of a frame, ready for an ImageData. */
export function paintCounts(
  frame: Frame16,
  levels: Levels,
  name: ColourMapName,
  saturationDn: number,
  markSaturated: boolean,
): Uint8ClampedArray<ArrayBuffer> {
  const map = colourMap(name);
  const table = new Uint8Array(65536 * 3);
  for (let dn = 0; dn < 65536; dn++) {
    const saturated = markSaturated && dn >= saturationDn;
    const step = Math.round(levelFraction(dn, levels) * 255);
    for (let c = 0; c < 3; c++) table[3 * dn + c] = saturated ? (SATURATED_RGB[c] ?? 0) : (map[3 * step + c] ?? 0);
  }
  const rgba = new Uint8ClampedArray(frame.pixels.length * 4);
  frame.pixels.forEach((dn, i) => {
    rgba[4 * i] = table[3 * dn] ?? 0;
    rgba[4 * i + 1] = table[3 * dn + 1] ?? 0;
    rgba[4 * i + 2] = table[3 * dn + 2] ?? 0;
    rgba[4 * i + 3] = 255;
  });
  return rgba;
}
