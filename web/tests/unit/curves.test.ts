import { describe, expect, it } from 'vitest';

import { aligned, azimuthMarks, azimuthRange, inadequacyShape, panels, variantsOf } from '../../src/lib/curves';
import { bestExposure, poseGrid } from '../../src/lib/poses';
import type { Curves, FrameRow } from '../../src/lib/types';

const point = (theta_c_deg: number, phi_s_deg: number) => ({ theta_c_deg, phi_s_deg, signal: 1, sigma: 0.01, predicted: null, residual: null });

describe('panels', () => {
  const data: Curves = {
    peak: 1,
    observations: [point(10.0003, 90), point(-20.0001, 0), point(9.9998, 0), point(-19.9997, 90)],
    curves: [
      { variant: 'sawtooth', theta_c_deg: 10, phi_s_deg: [0, 90], signal: [1, 1] },
      { variant: 'paper', theta_c_deg: 10, phi_s_deg: [0, 90], signal: [1, 1] },
      { variant: 'sawtooth', theta_c_deg: 45, phi_s_deg: [0], signal: [1] },
    ],
  };

  it('groups tilts that differ by read-back noise, with ascending azimuths', () => {
    expect(panels(data).map((p) => p.points.map((q) => q.phi_s_deg))).toEqual([[0, 90], [0, 90]]);
    expect(panels(data).map((p) => Math.round(p.theta_c_deg))).toEqual([-20, 10]);
  });

  it('has a panel for each planned tilt before its first observation', () => {
    const planned = panels(data, [-20, 0, 10]);
    expect(planned.map((p) => Math.round(p.theta_c_deg))).toEqual([-20, 0, 10]);
    expect(planned.map((p) => p.points.length)).toEqual([2, 0, 2]);
    expect(panels({ peak: 0, observations: [], curves: [] }, [5]).map((p) => p.theta_c_deg)).toEqual([5]);
  });

  it('has one azimuth axis for the whole scan', () => {
    expect(azimuthRange([0, 90, 180])).toEqual([-8, 368]);
    expect(azimuthRange([-30, 400])).toEqual([-38, 408]);
  });

  it('assigns curves to their tilt and drops those without one', () => {
    expect(panels(data).map((p) => p.curves.map((c) => c.variant))).toEqual([[], ['sawtooth', 'paper']]);
    expect(variantsOf(data)).toEqual(['sawtooth', 'paper']);
  });
});

describe('inadequacyShape', () => {
  it('is 1 at the peak and a tenth of that in the dark', () => {
    const panel = { theta_c_deg: 0, points: [point(0, 0)], curves: [{ variant: 'paper', phi_s_deg: [0, 90], signal: [2, 0] }] };
    const [peak, dark] = inadequacyShape(panel, 'paper', 2).map((s) => s.share);
    expect(peak).toBeCloseTo(1, 12);
    expect(dark).toBeCloseTo(0.1 / 1.1, 12);
    expect(inadequacyShape(panel, 'sawtooth', 2)[0]?.share).toBeCloseTo((1 + 0.2) / 2.2, 12);
  });
});

describe('aligned', () => {
  it('merges two sets of x, with null where one has no value', () => {
    expect(aligned([{ xs: [0, 2], ys: [5, 6] }, { xs: [2, 1], ys: [8, 7] }])).toEqual({ xs: [0, 1, 2], columns: [[5, null, 6], [null, 7, 8]] });
  });
});

describe('poseGrid', () => {
  const frame = (id: number, theta_c_deg: number, phi_s_deg: number, exposure_s = 0.02, rest: Partial<FrameRow> = {}): FrameRow => ({
    id, scan_id: 1, kind: 'sample', theta_c_deg, phi_s_deg, exposure_s, repeat: 0, mean_dn: 1, max_dn: 2, saturated_px: 0, accepted: true, reason: null, image: '', ...rest,
  });

  it('keeps a place for planned poses without frames', () => {
    const grid = poseGrid([frame(1, -20.0002, 0.0001)], [-20, 20], [0, 90]);
    expect(grid.tilts_deg).toEqual([-20, 20]);
    expect(grid.azimuths_deg).toEqual([0, 90]);
    expect(grid.cells.map((row) => row.map((cell) => cell.length))).toEqual([[1, 0], [0, 0]]);
  });

  it('prefers the longest exposure that is not saturated, some hot pixels allowed', () => {
    const [cell = []] = poseGrid([frame(3, 0, 0, 0.18, { saturated_px: 900 }), frame(2, 0, 0, 0.06, { saturated_px: 5 }), frame(1, 0, 0, 0.02)]).cells[0] ?? [];
    expect(cell.map((f) => f.id)).toEqual([1, 2, 3]);
    expect(bestExposure(cell)?.id).toBe(2);
    expect(bestExposure([frame(4, 0, 0, 0.02, { saturated_px: 9000 })])?.id).toBe(4);
    expect(bestExposure([])).toBeNull();
  });
});

describe('azimuthMarks', () => {
  it('are quarters of a turn, and finer where the range is smaller', () => {
    expect(azimuthMarks(-11, 371)).toEqual([0, 90, 180, 270, 360]);
    expect(azimuthMarks(-4, 94)).toEqual([0, 30, 60, 90]);
    expect(azimuthMarks(-4, 34)).toEqual([0, 10, 20, 30]);
    expect(azimuthMarks(-4, 4).length).toBeGreaterThan(2);
  });
});
