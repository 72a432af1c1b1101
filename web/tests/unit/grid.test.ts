import { describe, expect, it } from 'vitest';

import { parseList, printList, readWords } from '../../src/lib/grid';

function values(text: string): number[] {
  const outcome = parseList(text);
  if (!outcome.ok) throw new Error(outcome.reason);
  return outcome.values;
}

describe('parseList', () => {
  it('reads lists and ranges, both ends included', () => {
    expect(values('-20:10:20, 35')).toEqual([-20, -10, 0, 10, 20, 35]);
    expect(values('4:0:4')).toEqual([4]);
    expect(values('−20; 0 5.5')).toEqual([-20, 0, 5.5]);
    expect(values('20:-10:0')).toEqual([20, 10, 0]);
  });

  it('counts steps instead of adding them up', () => {
    expect(values('0:0.1:1')).toHaveLength(11);
    expect(values('0:0.1:1').at(-1)).toBe(1);
  });

  it('keeps a repeated value once', () => {
    expect(values('0, 0:90:180, 90')).toEqual([0, 90, 180]);
  });

  it.each(['', 'a', '1:2', '0:-1:5', '0:0:5', '1::3', '0:1e-9:1', 'NaN', 'Infinity'])('refuses %j with a reason', (text) => {
    const outcome = parseList(text);
    expect(outcome.ok).toBe(false);
    if (!outcome.ok) expect(outcome.reason).not.toBe('');
  });

  it('refuses an ambiguous comma', () => {
    for (const text of ['12,5', '20,65', '5,10', '2,5, 6', '-20,5:5:20']) {
      const outcome = parseList(text);
      expect(outcome.ok ? outcome.values : outcome.reason).toMatch(/is ambiguous/);
    }
    expect(values('-20,-10, 0')).toEqual([-20, -10, 0]);
    // Several commas separate values.
    expect(values('-20,-10,0,10,20')).toEqual([-20, -10, 0, 10, 20]);
    expect(values('0,90,180')).toEqual([0, 90, 180]);
    // A decimal number does not end in 0.
    expect(values('20,60')).toEqual([20, 60]);
    expect(values('0,90')).toEqual([0, 90]);
  });

  it('refuses a range that misses its end, such as one in the order of numpy', () => {
    const outcome = parseList('-20:20:5');
    expect(outcome.ok ? outcome.values : outcome.reason).toBe('The range -20:20:5 does not end at 5: write first:step:last, for example -20:20:0.');
  });

  it('reads units after numbers', () => {
    expect(values('-20°, 10 °, 5:5:20°')).toEqual([-20, 10, 5, 15, 20]);
    const ms = parseList('20 ms, 60ms', 'ms');
    expect(ms.ok ? ms.values : ms.reason).toEqual([20, 60]);
    expect(parseList('20 ms').ok).toBe(false);
  });

  it('refuses a range with a step of 0', () => {
    const outcome = parseList('1:0:5');
    expect(outcome.ok ? '' : outcome.reason).toBe('The range 1:0:5 has a step of 0.');
  });

  it('lists what was read, shortened if it is long', () => {
    expect(readWords([2, 5], 'exposure', (x) => `${x} ms`)).toBe('2 exposures: 2 ms, 5 ms');
    expect(readWords([0], 'tilt', (x) => `${x}°`)).toBe('1 tilt: 0°');
    expect(readWords([0, 1, 2, 3, 4, 5, 6], 'tilt', (x) => `${x}°`)).toBe('7 tilts: 0°, 1°, 2°, 3° … 6°');
  });

  it('reads back what it prints', () => {
    for (const list of [[-20, -10, 0, 10, 20], [0, 30, 60], [1, 2, 4], [5], [0, 0.1, 0.2]]) expect(values(printList(list))).toEqual(list);
  });
});
