// Dark and white-reference frames of earlier scans, by what they are and when they were taken.

import { when } from './format';
import type { Calibration } from './types';

const NAMES = { flat: 'white reference', dark: 'dark frames' } as const;

/** `white reference of scan 1 (17:34), dark frames of scan 1 (17:31)`; the white reference first, the newest of a kind first. */
export function calibrationWords(calibrations: readonly Calibration[], now = new Date()): string {
  return [...calibrations]
    .sort((a, b) => b.kind.localeCompare(a.kind) || b.created_at.localeCompare(a.created_at))
    .map((c) => `${NAMES[c.kind]} of scan ${c.scan_id} (${when(c.created_at, now)})`)
    .join(', ');
}
