import { describe, expect, it } from 'vitest';

import { controlLimits, movingRanges, signalsOf } from '../../src/lib/controlchart';

/** Flow rates of ten batches: NIST/SEMATECH e-Handbook of Statistical Methods, 6.3.2.2. */
const FLOW = [49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1];

describe('the control chart', () => {
  it('has the limits of the published example', () => {
    expect(movingRanges(FLOW).map((r) => Number(r.toFixed(1)))).toEqual([2, 2.3, 1.4, 3.5, 3.4, 1.4, 0.2, 1.2, 1.5]);
    const limits = controlLimits(FLOW);
    expect(limits?.mean).toBeCloseTo(50.81, 9);
    expect(limits?.meanRange).toBeCloseTo(1.8778, 4);
    expect(limits?.upper).toBeCloseTo(55.8041, 3);
    expect(limits?.lower).toBeCloseTo(45.8159, 3);
    // 3.267 · 1.8778.
    expect(limits?.rangeUpper).toBeCloseTo(6.1347, 3);
    expect(limits && signalsOf(FLOW, limits).beyond.includes(true)).toBe(false);
  });

  it('has no limits of a single value, and limits without width of equal ones', () => {
    expect(controlLimits([10])).toBeNull();
    expect(controlLimits([10, 10, 10])).toMatchObject({ n: 3, mean: 10, s: 0, lower: 10, upper: 10 });
  });

  it('marks values beyond the limits, not those on them', () => {
    const limits = { mean: 0, lower: -3, upper: 3 };
    expect(signalsOf([0, 3, 3.001, -3, -3.001], limits).beyond).toEqual([false, false, true, false, true]);
  });

  it('marks eight in a row on one side of the mean; a value on the mean ends a run', () => {
    const limits = { mean: 0, lower: -9, upper: 9 };
    const up = (n: number): number[] => new Array<number>(n).fill(1);
    expect(signalsOf(up(7), limits).runs).toEqual([]);
    expect(signalsOf([-1, ...up(8), -1], limits).runs).toEqual([{ from: 1, to: 8, above: true }]);
    expect(signalsOf([...up(5), 0, ...up(5)], limits).runs).toEqual([]);
    expect(signalsOf([...up(9), ...up(8).map((x) => -x)], limits).runs).toEqual([{ from: 0, to: 8, above: true }, { from: 9, to: 16, above: false }]);
    expect(signalsOf([-1, ...up(8)], limits).inRun).toEqual([false, ...up(8).map(() => true)]);
    expect(signalsOf(new Array<number>(9).fill(0), limits).runs).toEqual([]);
  });
});
