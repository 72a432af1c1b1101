import { describe, expect, it } from 'vitest';

import { poseColour, poseGrid, rateOf, stepTo } from '../../src/lib/poses';
import type { FrameRow } from '../../src/lib/types';

const frame = (theta_c_deg: number, phi_s_deg: number, mean_dn = 100): FrameRow => ({
  id: 1, scan_id: 1, kind: 'sample', theta_c_deg, phi_s_deg, exposure_s: 0.02, repeat: 0, mean_dn, max_dn: null, saturated_px: 0, accepted: true, reason: null, image: '',
});

describe('the grid of poses', () => {
  // Two tilts, three azimuths; the middle of the upper row is missing.
  const grid = poseGrid([frame(0, 0), frame(0, 180), frame(10, 0), frame(10, 90), frame(10, 180)]);

  it('follows arrow keys across empty places, and not beyond its edges', () => {
    expect(stepTo(grid, 'ArrowRight', 0, 0)).toEqual({ row: 0, column: 2 });
    expect(stepTo(grid, 'ArrowDown', 0, 0)).toEqual({ row: 1, column: 0 });
    expect(stepTo(grid, 'ArrowUp', 1, 1)).toBeNull();
    expect(stepTo(grid, 'ArrowLeft', 0, 0)).toBeNull();
    expect(stepTo(grid, 'Enter', 0, 0)).toBeNull();
  });

  it('is coloured by counts per second', () => {
    expect(rateOf(frame(0, 0))).toBe(5000);
    expect(rateOf(null)).toBe(0);
    expect(poseColour([frame(0, 0)], 'grey', 5000)).toBe('rgb(255 255 255)');
    expect(poseColour([frame(0, 0)], 'grey', 1e9)).toBe('rgb(0 0 0)');
  });
});
