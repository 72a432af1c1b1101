import { describe, expect, it } from 'vitest';

import { defectsOf, difference, paintDifference, referenceFor, regionOf, regionStatistics, symmetricReach } from '../../src/lib/frametools';
import type { FrameRow } from '../../src/lib/types';

const frame = { width: 4, height: 3, pixels: Uint16Array.from([10, 20, 30, 40, 50, 60, 70, 80, 90, 100, 65535, 120]) };
const row = (id: number, more: Partial<FrameRow>): FrameRow => ({ id, scan_id: 1, kind: 'sample', theta_c_deg: 0, phi_s_deg: 0, exposure_s: 0.02, repeat: 0, accepted: true, width_px: 4, height_px: 3, saturated_px: 0, ...more }) as FrameRow;
const never = () => false;

describe('a region', () => {
  it('has the corners of a drag in any direction', () => {
    expect(regionOf({ x: 3, y: 0 }, { x: 1, y: 2 })).toEqual({ left: 1, top: 0, right: 3, bottom: 2 });
  });

  it('has the statistics of its pixels', () => {
    const found = regionStatistics(frame, { left: 1, top: 0, right: 2, bottom: 1 }, never, never);
    expect(found).toMatchObject({ n: 4, mean: 45, min: 20, max: 70, saturated: 0, leftOut: 0 });
    expect(found?.std).toBeCloseTo(Math.sqrt((25 ** 2 + 15 ** 2 + 15 ** 2 + 25 ** 2) / 3), 9);
    expect(regionStatistics(frame, { left: 0, top: 0, right: 0, bottom: 0 }, never, never)?.std).toBeNull();
  });

  it('leaves defect pixels out, and counts saturated ones of a saturated frame', () => {
    const region = { left: 2, top: 1, right: 3, bottom: 2 };
    const full = (at: number): boolean => (frame.pixels[at] ?? 0) >= 65535;
    expect(regionStatistics(frame, region, defectsOf(frame, row(1, { saturated_px: 0 }), 65535), full)).toMatchObject({ n: 3, mean: 90, max: 120, saturated: 0, leftOut: 1 });
    expect(regionStatistics(frame, region, defectsOf(frame, row(1, { saturated_px: 9 }), 65535), full)).toMatchObject({ n: 4, max: 65535, saturated: 0.25, leftOut: 0 });
    expect(regionStatistics(frame, { left: 2, top: 2, right: 2, bottom: 2 }, full, full)).toBeNull();
  });
});

describe('a difference', () => {
  const other = { ...frame, pixels: Uint16Array.from([20, 20, 20, 20, 20, 20, 20, 20, 20, 20, 20, 20]) };

  it('is signed, and null for another size', () => {
    expect([...(difference(frame, other)?.pixels as Int32Array)].slice(0, 4)).toEqual([-10, 0, 10, 20]);
    expect(difference(frame, { ...other, width: 3, height: 4 })).toBeNull();
  });

  it('has a scale that is symmetric about zero and that one hot pixel does not widen', () => {
    const pixels = Int32Array.from({ length: 5000 }, (_, i) => (i % 2 === 0 ? -1 : 1) * (i % 50));
    pixels[3] = 60_000;
    expect(symmetricReach(pixels)).toBe(49);
    expect(symmetricReach([0, 0])).toBe(1);
    const rgba = paintDifference([-49, 0, 49, -200], 49, false);
    expect(rgba.slice(0, 3)).toEqual(rgba.slice(12, 15));
    // Zero is nearly white, and the ends are as dark as each other.
    expect(Math.min(...rgba.slice(4, 7))).toBeGreaterThan(240);
    expect(rgba[2]).toBeGreaterThan(rgba[0] ?? 255);
    expect(rgba[8]).toBeGreaterThan(rgba[10] ?? 255);
  });

  it('takes the reference of the same exposure, and the white reference at the nearest tilt', () => {
    const frames = [row(1, { kind: 'dark', exposure_s: 0.06 }), row(2, { kind: 'dark' }), row(3, { kind: 'flat', theta_c_deg: -20 }), row(4, { kind: 'flat', theta_c_deg: 9 }), row(5, { kind: 'flat', theta_c_deg: 10, accepted: false })];
    expect(referenceFor('dark', frames, row(9, {}))?.id).toBe(2);
    expect(referenceFor('flat', frames, row(9, { theta_c_deg: 10 }))?.id).toBe(4);
    expect(referenceFor('dark', [], row(9, {}))).toBeNull();
  });
});
