import { describe, expect, it } from 'vitest';

import { labelRoom, roundMarks, symmetricMarks } from '../../src/lib/axis';
import { dueSentence, signalSentences } from '../../src/lib/charted';
import type { ResultChart } from '../../src/lib/types';

const point = (scan_id: number, value: number, beyond = false): ResultChart['points'][number] => ({
  scan_id, region: null, fit_id: scan_id, part: 'A-1', verdict: null, verdict_id: null, specification: null, created_at: '2026-03-01T09:00:00Z',
  value, std: 0.01, expanded: 0.02, coverage_factor: 2, moving_range: null, beyond, in_run: false, range_beyond: false,
});

describe('the chart of results', () => {
  const limits = { n: 21, mean: 10.02, s: 0.05, lower: 9.87, upper: 10.17, mean_range: 0.05, range_limit: 0.16 };
  const points = [...Array.from({ length: 20 }, (_, i) => point(i + 1, 10)), point(21, 10.5, true), point(22, 9.5, true)];

  it('says its signals in words, the newest first', () => {
    expect(signalSentences({ points, limits, runs: [{ first: 0, last: 19, is_above: false }] }, 2, '°')).toEqual([
      'Scan 22: 9.50° is below the control limit 9.87° (mean − 3 s).',
      'Scan 21: 10.50° is above the control limit 10.17° (mean + 3 s).',
      'Scans 1 to 20: 20 values in a row below the mean.',
    ]);
    expect(signalSentences({ points: points.slice(0, 20), limits, runs: [] }, 2, '°')).toEqual([]);
    expect(signalSentences({ points: [point(1, 10)], limits: null, runs: [] }, 2, '°')).toEqual([]);
  });

  it('says what is due', () => {
    const now = new Date(2026, 2, 9, 12);
    const [last_at, due_at] = [new Date(2026, 2, 2, 9).toISOString(), new Date(2026, 2, 9, 9).toISOString()];
    const standard = { what: 'check-standard', part: 'CS-1', last_at, due_at, is_due: true } as const;
    expect(dueSentence(standard, now)).toBe('Check standard CS-1 was last measured 2026-03-02 09:00: due since 09:00.');
    expect(dueSentence({ ...standard, is_due: false }, now)).toBe('Check standard CS-1 was last measured 2026-03-02 09:00: due 09:00.');
    expect(dueSentence({ what: 'references', part: null, last_at: null, due_at: null, is_due: true }, now)).toBe('References were never taken: due now.');
  });
});

describe('marks of an axis', () => {
  it('are at round numbers within its ends', () => {
    expect(roundMarks(9.7, 10.4, 6)).toEqual({ at: [9.8, 10, 10.2, 10.4].map((x) => expect.closeTo(x, 9) as number), decimals: 1 });
    expect(roundMarks(0, 0.0121, 2)).toEqual({ at: [0, 0.01], decimals: 2 });
    expect(roundMarks(-30, 120, 5)).toEqual({ at: [0, 50, 100], decimals: 0 });
    expect(roundMarks(5, 5, 4).at).toEqual([5]);
  });

  it('about zero are two on each side, within the ends', () => {
    for (const [reach, top] of [[0.0115, 0.01], [0.0199, 0.01], [0.0201, 0.02], [3.9, 2], [8, 8], [99, 80]] as const) {
      expect(symmetricMarks(reach)).toEqual([-1, -0.5, 0, 0.5, 1].map((share) => expect.closeTo(share * top, 12) as number));
    }
    expect(symmetricMarks(0)).toEqual([0]);
  });
});

describe('the room of an axis', () => {
  it('holds its longest number', () => {
    expect(labelRoom(['0', '0.2'])).toBe(46);
    // 11 px Inter with figures of equal width takes 6.6 px a character; the gap to the plot is 4 px.
    expect(labelRoom(['−0.00005', '0'])).toBeGreaterThanOrEqual(8 * 6.6 + 4);
  });
});
