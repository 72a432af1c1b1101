// Dark and white-reference frames of earlier scans, by what they are and when they were taken.

import { when } from './format';
import type { Calibration, Scan } from './types';

export const CALIBRATION_NAMES = { flat: 'white reference', dark: 'dark frames' } as const;

/** A scan without a sample: it took dark and white-reference frames only. */
export const isCalibration = (scan: Scan): boolean => scan.plan.repeats === 0;

/** Kinds in the order of their acquisition. */
export function inOrder(calibrations: readonly Calibration[]): readonly Calibration[] {
  return [...calibrations].sort((a, b) => a.kind.localeCompare(b.kind) || a.id - b.id);
}

/** `white reference of scan 1 (17:34), dark frames of scan 1 (17:31)`; the white reference first, the newest of a kind first. */
export function calibrationWords(calibrations: readonly Calibration[], now = new Date()): string {
  return [...calibrations]
    .sort((a, b) => b.kind.localeCompare(a.kind) || b.created_at.localeCompare(a.created_at))
    .map((c) => `${CALIBRATION_NAMES[c.kind]} of scan ${c.scan_id} (${when(c.created_at, now)})`)
    .join(', ');
}
