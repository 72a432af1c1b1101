import { describe, expect, it } from 'vitest';

import { labelRoom, roundMarks } from '../../src/lib/axis';
import { chartOf, signalSentences } from '../../src/lib/charted';
import type { ResultRow } from '../../src/lib/types';

const row = (scan_id: number, theta_r_deg: number | null, more: Partial<ResultRow> = {}): ResultRow => ({ scan_id, status: 'converged', theta_r_deg, theta_r_deg_std: 0.01, theta_r_deg_expanded: 0.023, ...more });

describe('the chart of results', () => {
  it('has the values of converged fits with U, in the order of the rows', () => {
    const rows = [row(1, 10), row(2, 10.1), row(3, null), row(4, 9.9, { status: 'at-bound' }), row(5, 10.2, { alpha_u: 0.1, alpha_u_std: 0.002 })];
    const chart = chartOf(rows, 'theta_r_deg');
    expect(chart.points.map((p) => [p.row.scan_id, p.value, p.expanded, p.range === null ? null : Number(p.range.toFixed(6))])).toEqual([[1, 10, 0.023, null], [2, 10.1, 0.023, 0.1], [5, 10.2, 0.023, 0.1]]);
    expect(chart.omitted).toBe(2);
    // Mean moving range 0.1, so s = 0.1 / 1.128.
    expect(chart.limits?.s).toBeCloseTo(0.08865, 5);
    expect(chartOf(rows, 'alpha_u').points.map((p) => p.expanded)).toEqual([0.004]);
  });

  it('says its signals in words, the newest first', () => {
    const calm = Array.from({ length: 20 }, (_, i) => row(i + 1, 10 + (i % 2 ? 0.01 : -0.01)));
    expect(signalSentences(chartOf(calm, 'theta_r_deg'), 2, '°')).toEqual([]);
    const high = chartOf([...calm, row(21, 10.5), ...calm.slice(0, 3)], 'theta_r_deg');
    expect(signalSentences(high, 2, '°')).toEqual([
      expect.stringMatching(/^Scan 21: 10\.50° is above the control limit 10\.\d\d° \(mean \+ 3 s\)\.$/),
      'Scans 1 to 20: 20 values in a row below the mean.',
    ]);
  });
});

describe('marks of an axis', () => {
  it('are at round numbers within its ends', () => {
    expect(roundMarks(9.7, 10.4, 6)).toEqual({ at: [9.8, 10, 10.2, 10.4].map((x) => expect.closeTo(x, 9) as number), decimals: 1 });
    expect(roundMarks(0, 0.0121, 2)).toEqual({ at: [0, 0.01], decimals: 2 });
    expect(roundMarks(-30, 120, 5)).toEqual({ at: [0, 50, 100], decimals: 0 });
    expect(roundMarks(5, 5, 4).at).toEqual([5]);
  });
});

describe('the room of an axis', () => {
  it('holds its longest number', () => {
    expect(labelRoom(['0', '0.2'])).toBe(46);
    // 11 px Inter with figures of equal width takes 6.6 px a character; the gap to the plot is 4 px.
    expect(labelRoom(['−0.00005', '0'])).toBeGreaterThanOrEqual(8 * 6.6 + 4);
  });
});
