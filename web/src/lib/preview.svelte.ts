// The newest look through the camera, and what it says about the exposures of the next scan.

import { exposure } from './format';
import type { Preview } from './types';

/** Brightest pixel of a suggested exposure, as a share of a full pixel (the daemon's). */
const SUGGESTED_SHARE = 0.7;
/** A frame whose brightest pixel reaches less is mostly noise. */
const DIM_SHARE = 0.03;

class PreviewState {
  /** Whether Measure shows the camera. Its card is read when it is opened. */
  open = $state(false);
  last = $state.raw<Preview | null>(null);
  /** Exposure at which the brightest pixel of the last look would be full, s; null if no look has shown it. */
  full_s = $state<number | null>(null);

  take(preview: Preview, saturationDn: number): void {
    this.last = preview;
    this.full_s = fullExposure(preview, saturationDn) ?? this.full_s;
  }
}

/** Exposure at which the brightest pixel of a preview is full, s; null if no frame is bright and not full. */
export function fullExposure(preview: Pick<Preview, 'suggestion'> & { readonly frames: readonly Pick<Preview['frames'][number], 'exposure_s' | 'max_dn' | 'saturated_px'>[] }, saturationDn: number): number | null {
  const [suggested] = preview.suggestion?.exposures_s ?? [];
  if (suggested !== undefined && preview.suggestion?.reason === null) return suggested / SUGGESTED_SHARE;
  // The black level is not known here, and is a small part of a bright frame.
  const bright = preview.frames.filter((f) => f.saturated_px === 0 && f.max_dn > 0.1 * saturationDn).at(-1);
  return bright ? (bright.exposure_s * saturationDn) / bright.max_dn : null;
}

/** What is wrong with the exposures of a scan, judged by the last look; null if nothing is, or nothing was seen. */
export function exposureWarning(exposures_s: readonly number[], full_s: number | null): string | null {
  if (full_s === null || exposures_s.length === 0) return null;
  const [shortest, longest] = [Math.min(...exposures_s), Math.max(...exposures_s)];
  if (shortest >= full_s) return `By the last look, pixels saturate from ${exposure(Number(full_s.toPrecision(2)))} on, so ${exposure(shortest)} is too long at that pose.`;
  if (longest < DIM_SHARE * full_s) return `By the last look, ${exposure(longest)} uses less than ${100 * DIM_SHARE} % of the range of the camera: most of it would be noise.`;
  return null;
}

export const preview = new PreviewState();
