import { describe, expect, it } from 'vitest';

import { fewPosesWarning, type GridDraft, gridListsOf, gridOf, newGrid, type PlanRequest, planWords, posesOf, readGrid, recipeWords, unusualExposure, valuesOf } from '../../src/lib/plan';

const draft = (change: Partial<GridDraft>): GridDraft => ({ ...newGrid(), ...change });

describe('a typed grid', () => {
  it('makes the plan of a preset or of lists, exposures in seconds', () => {
    expect(readGrid(newGrid()).plan).toEqual({ preset: 'paper', repeats: 1 });
    const own = readGrid(draft({ grid: 'custom', tilts: '-20,-10,0,10,20', azimuths: '0°, 90°', exposures: '20,60', repeats: '2' }));
    expect(own.plan).toEqual({ theta_c_deg: [-20, -10, 0, 10, 20], phi_s_deg: [0, 90], exposures_s: [0.02, 0.06], repeats: 2 });
    expect(own.readings).toEqual(['5 tilts: −20°, −10°, 0°, 10°, 20°', '2 azimuths: 0°, 90°', '2 exposures: 20 ms, 60 ms']);
  });

  it('has no plan with a fault, which is at its field', () => {
    const wrong = readGrid(draft({ grid: 'custom', tilts: '2,5', azimuths: '', repeats: '1,5' }));
    expect(wrong.plan).toBeNull();
    expect(Object.keys(wrong.faults).sort()).toEqual(['azimuths', 'repeats', 'tilts']);
    // Lists of a preset are not read.
    const travel = { theta_c: { limit_min_deg: -60, limit_max_deg: 60 }, phi_s: { limit_min_deg: -20, limit_max_deg: 390 } };
    const far = readGrid(draft({ grid: 'custom', tilts: '0,70', azimuths: '0,400', exposures: '20,4000000' }), travel);
    expect(far.plan).toBeNull();
    expect(far.faults).toEqual({ tilts: '70° is not within −60° to 60°.', azimuths: '400° is not within −20° to 390°.', exposures: '4000 s is not within 0.001 ms to 3600 s.' });
    expect(readGrid(draft({ tilts: 'x' })).faults).toEqual({});
    for (const repeats of ['0', '101', '', 'two']) expect(readGrid(draft({ repeats })).faults.repeats, repeats).toBe('Give a whole number from 1 to 100.');
  });
});

describe('a plan', () => {
  it('is written into the fields that make it again', () => {
    const plans: PlanRequest[] = [
      { preset: 'full', repeats: 3, exposures_s: [0.0025] },
      { theta_c_deg: [-20, 0, 5], phi_s_deg: [0, 90, 180], repeats: 1 },
      { poses: [{ theta_c_deg: 5, phi_s_deg: 10 }, { theta_c_deg: 0, phi_s_deg: 20 }], repeats: 2 },
    ];
    for (const plan of plans) expect(readGrid(gridOf(plan)).plan).toEqual(plan);
    // A range, and a preset whose azimuths are stated, become lists.
    const mixed = readGrid(gridOf({ preset: 'paper', phi_s_deg: { from: 0, to: 90, step: 45 } })).plan;
    expect(mixed).toEqual({ theta_c_deg: [-20, -10, 0, 10, 20], phi_s_deg: [0, 45, 90], repeats: 1 });
  });

  it('is one line', () => {
    expect(planWords({ preset: 'full' }, 3)).toBe('9 tilts × 12 azimuths × 3 exposures');
    expect(planWords({ theta_c_deg: { from: -20, to: 21, step: 10 }, phi_s_deg: [0], exposures_s: [0.1], repeats: 2 }, 3)).toBe('5 tilts × 1 azimuth × 1 exposure, 2 frames of each');
    expect(planWords({ poses: [{ theta_c_deg: 5, phi_s_deg: 10 }, { theta_c_deg: 0, phi_s_deg: 20 }] }, 3)).toBe('2 poses × 3 exposures');
    expect(recipeWords({ name: 'x', plan: { preset: 'paper' }, target_expanded_deg: 0.05 }, 0)).toBe('5 tilts × 3 azimuths · target U(θr) ≤ 0.05°');
  });

  it('has the poses of its preset, or its own', () => {
    expect(gridListsOf({ preset: 'paper', phi_s_deg: { from: 0, to: 90, step: 45 } })).toEqual({ tilts: [-20, -10, 0, 10, 20], azimuths: [0, 45, 90] });
    expect(gridListsOf({ preset: 'full' }).azimuths).toHaveLength(12);
    expect(gridListsOf({ theta_c_deg: [5], phi_s_deg: [0] })).toEqual({ tilts: [5], azimuths: [0] });
    expect(posesOf({ theta_c_deg: [5, 6], phi_s_deg: [0] })).toEqual([{ theta_c_deg: 5, phi_s_deg: 0 }, { theta_c_deg: 6, phi_s_deg: 0 }]);
    const poses = [{ theta_c_deg: 1, phi_s_deg: 2 }];
    expect(posesOf({ poses })).toBe(poses);
  });

  it('has the values of a range without the errors of a running sum', () => {
    expect(valuesOf({ from: 0, to: 1, step: 0.1 })).toHaveLength(11);
    expect(valuesOf({ from: 0, to: 1, step: 0.1 }).at(-1)).toBe(1);
    expect(valuesOf(null)).toEqual([]);
  });
});

describe('fewPosesWarning', () => {
  it('names the poses that a fit of the material needs', () => {
    const grid = (theta_c_deg: number[]): PlanRequest => ({ theta_c_deg, phi_s_deg: [0, 90] });
    expect(fewPosesWarning(grid([0]), 'dielectric')).toBe('2 poses are too few: a fit needs at least 9 poses.');
    expect(fewPosesWarning(grid([0, 1, 2, 3]), 'dielectric')).toBe('8 poses are too few: a fit needs at least 9 poses.');
    expect(fewPosesWarning(grid([0, 1, 2, 3]), 'conductor')).toBe('');
    expect(fewPosesWarning({ preset: 'paper' }, 'dielectric')).toBe('');
  });
});

describe('unusualExposure', () => {
  it('names an exposure that is far from those of a camera', () => {
    expect(unusualExposure([0.02, 20])).toBe('20 s is an unusually long exposure.');
    expect(unusualExposure([0.00002])).toBe('0.02 ms is an unusually short exposure.');
    expect([unusualExposure([1e-4, 0.06, 10]), unusualExposure([]), unusualExposure()]).toEqual(['', '', '']);
  });
});
