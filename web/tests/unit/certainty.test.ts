import { describe, expect, it } from 'vitest';

import { expandedAngle, logarithmic, merged, newestKnown, reachedAt, timeScale } from '../../src/lib/certainty';
import type { Certainty } from '../../src/lib/types';

const row = (id: number, elapsed_s: number, parameters: Certainty['parameters']): Certainty => ({
  id, elapsed_s, n_observations: id, n_frames_used: id, variant: 'sawtooth', status: 'converged', parameters,
});

describe('the live fit', () => {
  it('has each row once, in the order of the rig’s time', () => {
    const [a, b, c] = [row(3, 60, {}), row(7, 90, {}), row(9, 120, {})];
    expect(merged([b, a], [c, b]).map((r) => r.id)).toEqual([3, 7, 9]);
  });

  const angle = (std: number): Certainty['parameters'] => ({ theta_r_deg: { value: 10, std } });

  it('draws the expanded uncertainty, with gaps where the angle was not determined, on a scale that contains it', () => {
    const rows = [row(1, 10, {}), row(2, 20, angle(0.15)), row(3, 30, angle(0.05))];
    expect(rows.map(expandedAngle)).toEqual([null, 0.3, 0.1]);
    // Few degrees of freedom: the row has a factor of its own.
    expect(expandedAngle(row(5, 50, { theta_r_deg: { value: 10, std: 0.1, coverage_factor: 4.5 } }))).toBeCloseTo(0.45, 12);
    expect(newestKnown([...rows, row(4, 40, {})])?.id).toBe(3);
    expect(newestKnown([row(1, 10, {})])).toBeNull();
    expect(logarithmic(rows.map(expandedAngle))).toEqual({ low: 0.05, high: 0.5, marks: [0.05, 0.1, 0.2, 0.5] });
  });

  it('has reached a target once it stays within it', () => {
    const rows = [row(1, 10, angle(0.04)), row(2, 20, angle(0.2)), row(3, 30, {}), row(4, 40, angle(0.05)), row(5, 50, angle(0.03))];
    expect(reachedAt(rows, 0.1)?.id).toBe(4);
    expect(reachedAt(rows, 0.05)).toBeNull();
    expect(reachedAt(rows.slice(0, 2), 0.1)).toBeNull();
    expect(reachedAt([], 0.1)).toBeNull();
  });

  it('has a scale with few round marks for any range', () => {
    const between = (...stds: number[]) => logarithmic(stds);
    expect(between(0.0111)).toEqual({ low: 0.01, high: 0.02, marks: [0.01, 0.02] });
    expect(between(0.0106)).toEqual({ low: 0.005, high: 0.02, marks: [0.005, 0.01, 0.02] });
    expect(between(3e-5, 40).marks).toEqual([1e-4, 1e-3, 0.01, 0.1, 1, 10]);
    expect(between()).toEqual({ low: 1e-3, high: 1, marks: expect.arrayContaining([0.001, 0.1, 1]) as unknown });
    for (let e = -20; e < 20; e += 0.037) {
      const [least, most] = [10 ** e, 10 ** (1.3 * e + 7)].sort((a, b) => a - b) as [number, number];
      const { low, high, marks } = between(least, most);
      expect(low).toBeLessThan(least);
      expect(high).toBeGreaterThan(most);
      expect(marks.length).toBeGreaterThanOrEqual(2);
      expect(marks.length).toBeLessThanOrEqual(8);
      expect(marks.every((m, i) => m >= low && m <= high && (i === 0 || m > (marks[i - 1] ?? m)))).toBe(true);
    }
  });
});

describe('the rig’s time', () => {
  it('is in seconds while it is short, with at most eight round marks', () => {
    expect(timeScale(26.1)).toMatchObject({ unit: 's', marks: [0, 5, 10, 15, 20, 25] });
    expect(timeScale(119).unit).toBe('s');
    expect(timeScale(180)).toMatchObject({ unit: 'min', marks: [0, 0.5, 1, 1.5, 2, 2.5, 3] });
    for (let s = 0.1; s < 1e6; s *= 1.3) {
      const { marks, high } = timeScale(s);
      expect(marks.length).toBeLessThanOrEqual(8);
      expect(marks.length).toBeGreaterThanOrEqual(2);
      expect(marks.at(-1) ?? 1e9).toBeLessThanOrEqual(high);
    }
  });
});
