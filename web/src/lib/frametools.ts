// Regions of a frame with their statistics, and differences of two frames.

import { perceptual, STEPS } from './perceptual';
import type { Frame16 } from './png16';
import { isSaturated } from './poses';
import type { FrameRow } from './types';

/** Counts, or differences of counts, row by row. */
export interface Counts {
  readonly width: number;
  readonly height: number;
  readonly pixels: ArrayLike<number>;
}

/** A rectangle of pixels, both corners included. */
export interface Region {
  readonly left: number;
  readonly top: number;
  readonly right: number;
  readonly bottom: number;
}

interface RegionStatistics {
  /** Pixels that count. */
  readonly n: number;
  readonly mean: number;
  /** Standard deviation of one pixel; null for a single one. */
  readonly std: number | null;
  readonly min: number;
  readonly max: number;
  /** Share of the pixels that are at or above saturation, of those that count. */
  readonly saturated: number;
  /** Defect pixels, which do not count. */
  readonly leftOut: number;
}

/** The rectangle between two corners, in any order. */
export function regionOf(a: { readonly x: number; readonly y: number }, b: { readonly x: number; readonly y: number }): Region {
  return { left: Math.min(a.x, b.x), top: Math.min(a.y, b.y), right: Math.max(a.x, b.x), bottom: Math.max(a.y, b.y) };
}

/** Pixels at saturation of a frame that is not saturated are defects: the daemon masks them. */
export function defectsOf(frame: Frame16, row: FrameRow, saturationDn: number): (at: number) => boolean {
  if (isSaturated(row)) return () => false;
  return (at) => (frame.pixels[at] ?? 0) >= saturationDn;
}

/** Statistics of a region; null if each of its pixels is a defect. */
export function regionStatistics(shown: Counts, region: Region, isDefect: (at: number) => boolean, isFull: (at: number) => boolean): RegionStatistics | null {
  let [n, leftOut, full, mean, squares, min, max] = [0, 0, 0, 0, 0, Number.POSITIVE_INFINITY, Number.NEGATIVE_INFINITY];
  for (let y = region.top; y <= Math.min(region.bottom, shown.height - 1); y++) {
    for (let x = region.left; x <= Math.min(region.right, shown.width - 1); x++) {
      const at = y * shown.width + x;
      if (isDefect(at)) {
        leftOut += 1;
        continue;
      }
      const dn = shown.pixels[at] ?? 0;
      n += 1;
      if (isFull(at)) full += 1;
      // Welford: a sum of squares of 16-bit counts loses digits.
      const from = dn - mean;
      mean += from / n;
      squares += from * (dn - mean);
      min = Math.min(min, dn);
      max = Math.max(max, dn);
    }
  }
  return n === 0 ? null : { n, mean, std: n > 1 ? Math.sqrt(squares / (n - 1)) : null, min, max, saturated: full / n, leftOut };
}

/** The first frame minus the second, in DN; null if their sizes differ. */
export function difference(first: Frame16, second: Frame16): Counts | null {
  if (first.width !== second.width || first.height !== second.height) return null;
  return { width: first.width, height: first.height, pixels: Int32Array.from(first.pixels, (dn, at) => dn - (second.pixels[at] ?? 0)) };
}

/** The size in DN that all but 0.2 % of the differences stay below: both ends of a symmetric colour scale. At least 1. */
export function symmetricReach(pixels: ArrayLike<number>): number {
  const counts = new Uint32Array(65536);
  for (let i = 0; i < pixels.length; i++) {
    const size = Math.min(65535, Math.abs(pixels[i] ?? 0));
    counts[size] = (counts[size] ?? 0) + 1;
  }
  let seen = 0;
  for (let size = 0; size < 65536; size++) {
    seen += counts[size] ?? 0;
    if (seen >= 0.998 * pixels.length) return Math.max(1, size);
  }
  return 65535;
}

/** RGBA bytes of differences: zero has the colour in the middle. */
export function paintDifference(pixels: ArrayLike<number>, reach: number, dark: boolean): Uint8ClampedArray<ArrayBuffer> {
  const table = perceptual('diverging', dark);
  const rgba = new Uint8ClampedArray(pixels.length * 4);
  for (let i = 0; i < pixels.length; i++) {
    const share = Math.min(1, Math.max(-1, (pixels[i] ?? 0) / reach));
    const step = Math.round(((share + 1) / 2) * (STEPS - 1));
    for (let c = 0; c < 3; c++) rgba[4 * i + c] = table[3 * step + c] ?? 0;
    rgba[4 * i + 3] = 255;
  }
  return rgba;
}

/** The dark frame or white reference of a scan for a frame: of its exposure if there is one, at the nearest tilt. */
export function referenceFor(kind: 'dark' | 'flat', frames: readonly FrameRow[], row: FrameRow): FrameRow | null {
  const distance = (f: FrameRow): number => Math.abs(Math.log(f.exposure_s / row.exposure_s)) * 1000 + (kind === 'flat' ? Math.abs(f.theta_c_deg - row.theta_c_deg) : 0);
  return frames.filter((f) => f.kind === kind && f.id !== row.id && f.accepted).reduce<FrameRow | null>((best, f) => (best === null || distance(f) < distance(best) ? f : best), null);
}
