import { describe, expect, it } from 'vitest';

import { parseList, printList } from '../../src/lib/grid';

function values(text: string): number[] {
  const outcome = parseList(text);
  if (!outcome.ok) throw new Error(outcome.reason);
  return outcome.values;
}

describe('parseList', () => {
  it('reads lists and ranges, both ends included', () => {
    expect(values('-20:10:20, 35')).toEqual([-20, -10, 0, 10, 20, 35]);
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

  it('reads back what is printed', () => {
    for (const list of [[-20, -10, 0, 10, 20], [0, 30, 60], [1, 2, 4], [5], [0, 0.1, 0.2]]) expect(values(printList(list))).toEqual(list);
  });
});
