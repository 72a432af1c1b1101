import { describe, expect, it } from 'vitest';

import { foretold } from '../../src/lib/forecast';
import { angle, between, bytes, count, counted, coverageWords, decade, decimalsFor, decimalsOfStep, duration, exposure, fixed, heldWords, moment, percent, plain, significant, timeLeft, when, withUncertainty } from '../../src/lib/format';

describe('coverageWords', () => {
  it('states the one factor, or the range of several', () => {
    expect(coverageWords([2, null, 2.0001])).toBe('k = 2');
    expect(coverageWords([4.5268, 2, undefined, 2.13])).toBe('k = 2 … 4.53');
    expect(coverageWords([])).toBe('k = 2');
    expect(coverageWords([12.71])).toBe('k = 12.7');
  });
});

describe('withUncertainty', () => {
  it('rounds value and uncertainty to the same place, two digits of the uncertainty', () => {
    expect(withUncertainty(10.03127, 0.0849)).toEqual({ value: '10.031', uncertainty: '0.085' });
    expect(withUncertainty(0.120481, 0.00231)).toEqual({ value: '0.1205', uncertainty: '0.0023' });
    expect(withUncertainty(-3.2, 1.24)).toEqual({ value: '−3.2', uncertainty: '1.2' });
  });

  it('does not print three digits where rounding carries over', () => {
    expect(withUncertainty(1, 0.0996)).toEqual({ value: '1.00', uncertainty: '0.10' });
    expect(decimalsFor(9.96)).toBe(0);
  });

  it('adds the noun to a count', () => {
    expect([counted(1, 'tilt'), counted(0, 'frame'), counted(12000, 'frame')]).toEqual(['1 tilt', '0 frames', '12\u202f000 frames']);
  });

  it('has a default without an uncertainty', () => {
    expect(decimalsFor(0)).toBe(4);
    expect(decimalsFor(Number.NaN)).toBe(4);
  });
});

describe('numbers', () => {
  it('never print a negative zero, and print a true minus', () => {
    expect(fixed(-0.0004, 3)).toBe('0.000');
    expect(fixed(-0.0006, 3)).toBe('−0.001');
    expect(angle(-20)).toBe('−20°');
    expect(angle(12.5)).toBe('12.5°');
    expect(angle(-0.0001)).toBe('0°');
  });

  it('keep their significant digits at every size', () => {
    expect(significant(0.0123)).toBe('0.012');
    expect(significant(81000)).toBe('81000');
    expect(significant(0.000012)).toBe('1.2\u202f×\u202f10⁻⁵');
    expect(significant(9.99e-5)).toBe('0.00010');
    expect(significant(0)).toBe('0');
    expect(percent(0.0061)).toBe('0.61\u202f%');
    expect([plain(12.5), plain(-15), plain(550, 5), plain(0)]).toEqual(['12.5', '−15', '550', '0']);
  });

  it('group digits by three', () => {
    expect(count(65535)).toBe('65\u202f535');
    expect(count(999)).toBe('999');
    expect(count(1234567)).toBe('1\u202f234\u202f567');
  });

  it('format times, sizes and exposures', () => {
    expect(duration(59.4)).toBe('59 s');
    expect(duration(59.6)).toBe('1 min 00 s');
    expect(duration(260)).toBe('4 min 20 s');
    expect(duration(7500)).toBe('2 h 05 min');
    expect(bytes(999)).toBe('999 B');
    expect(bytes(9_400_000)).toBe('9.4 MB');
    expect(bytes(999_950)).toBe('1.0 MB');
    expect(bytes(61e9)).toBe('61.0 GB');
    expect(exposure(0.02)).toBe('20 ms');
    expect(exposure(0.18)).toBe('0.18 s');
  });
});

describe('timeLeft', () => {
  const at = (fraction: number, elapsed_s: number, time_left_s: number | null): string => timeLeft({ fraction, elapsed_s, time_left_s });
  it('is empty before the pace is known and in the last moment', () => {
    expect([at(0.25, 4, 12), at(0, 4, 0), at(0.001, 0.01, 30), at(0.999, 40, 0.04), at(0.5, 3, null), timeLeft(undefined)]).toEqual([', 12 s left', '', '', '', '', '']);
  });
});

describe('between', () => {
  it('gives both ends enough decimals to distinguish them', () => {
    expect(between(9.9761, 10.0204)).toEqual(['9.976', '10.020']);
    expect(between(4.1641, 10.291)).toEqual(['4.2', '10.3']);
    expect(between(-0.0004, 0.0004)).toEqual(['−0.00040', '0.00040']);
    expect(between(0.3, 0.3)).toEqual(['0.30000', '0.30000']);
  });
});

describe('when', () => {
  it('omits the date only if it is today', () => {
    const now = new Date(2026, 10, 21, 15, 0);
    expect(when(new Date(2026, 10, 21, 9, 5).toISOString(), now)).toBe('09:05');
    expect(when(new Date(2026, 10, 20, 9, 5).toISOString(), now)).toBe('2026-11-20 09:05');
    expect(when(null)).toBe('');
  });
});

describe('decade', () => {
  it('writes ticks of a logarithmic axis as powers of ten', () => {
    expect([1e-7, 9.9999999e-8, 5e-7, 1e4, 2e6].map((x) => decade(x).replaceAll('\u202f', ' '))).toEqual(['10⁻⁷', '10⁻⁷', '5 × 10⁻⁷', '10⁴', '2 × 10⁶']);
  });
});

describe('a forecast', () => {
  it('states what a time limit leaves of Monte Carlo work', () => {
    const all = { seconds: 4, at_most: false, cut_short: true, uncut_seconds: 100, amount: { count: 1_000_000, of: 'photons' }, error: { value: 0.01, of: 'a reflected bin' } };
    expect(foretold(all)).not.toContain('at the limit');
    const text = foretold({ ...all, at_limit: { count: 40_000, error: 0.05 } });
    expect(text).toMatch(/photons \(about 40\D?000 at the limit\)/);
    expect(text).toMatch(/about 1\.0\D*% \(5\.0\D*% at the limit\)/);
  });
});

describe('decimalsOfStep', () => {
  it('are enough to write every mark exactly', () => {
    expect([0.025, 0.05, 0.5, 1, 20, 2.5, 0.1, 1e-4, 2.5e-4].map(decimalsOfStep)).toEqual([3, 2, 1, 0, 0, 1, 1, 4, 5]);
    expect(decimalsOfStep(-0.025)).toBe(3);
    expect(decimalsOfStep(0.075 - 0.05)).toBe(3);
  });
});

describe('heldWords', () => {
  it('has the digits that were typed, without those of binary rounding', () => {
    expect(heldWords(12.000000000000002, '°')).toBe('12° (fixed)');
    expect(heldWords(-0.125)).toBe('−0.125 (fixed)');
  });
});

describe('moment', () => {
  it('has date, seconds and the offset of the local time from UTC', () => {
    const text = moment('2026-01-02T17:34:05Z');
    expect(text).toMatch(/^2026-01-0\d \d{2}:\d{2}:05 [+−]\d{2}:\d{2}$/);
    // The offset leads back to the same time.
    expect(new Date(text.replace(' ', 'T').replace(' ', '').replace('−', '-')).toISOString()).toBe('2026-01-02T17:34:05.000Z');
    expect(moment(null)).toBe('');
  });
});
