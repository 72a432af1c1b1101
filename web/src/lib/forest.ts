// Values with their expanded uncertainties on one axis: the range of the axis, and the place of each whisker.

import type { Fit, Parameter } from './types';

type Angle = Pick<Parameter, 'value' | 'expanded'>;

/** The newest finished fit of each scan. */
export function newestFits(fits: readonly Fit[]): Map<number, Fit> {
  const found = new Map<number, Fit>();
  for (const fit of fits) if (fit.state === 'completed' && fit.id > (found.get(fit.scan_id)?.id ?? 0)) found.set(fit.scan_id, fit);
  return found;
}

type Measured = { readonly value: number; readonly expanded: number };
/** A value without an uncertainty was held, not measured. */
const isMeasured = (angle: Angle): angle is Measured => angle.value !== null && angle.expanded !== null;

/** Ends of an axis that contains all measured values with a margin. */
export function spanOf(angles: readonly Angle[]): readonly [number, number] {
  const known = angles.filter(isMeasured);
  if (known.length === 0) return [0, 1];
  const low = Math.min(...known.map((a) => a.value - a.expanded));
  const high = Math.max(...known.map((a) => a.value + a.expanded));
  const pad = Math.max(0.08 * (high - low), 0.02);
  return [low - pad, high + pad];
}

/** Place of a value and its whisker along the axis, percent of its length; `right` counts from the right end. Null without a measured value. */
export function whiskerOf(angle: Angle, [low, high]: readonly [number, number]): { readonly at: number; readonly left: number; readonly right: number } | null {
  if (!isMeasured(angle)) return null;
  const { value, expanded } = angle;
  const place = (x: number): number => Math.min(100, Math.max(0, (100 * (x - low)) / (high - low)));
  return { at: place(value), left: place(value - expanded), right: 100 - place(value + expanded) };
}
