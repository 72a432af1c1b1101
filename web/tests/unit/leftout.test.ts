import { describe, expect, it } from 'vitest';

import { leftOutByCost } from '../../src/lib/leftout';

describe('what was left out', () => {
  it('has the largest error first, then unknown errors, and separately terms without error', () => {
    const item = (what: string, cost: number | null) => ({ what, why: '', cost });
    const { costly, free } = leftOutByCost([item('a', 0), item('b', null), item('c', 1e-5), item('d', 0.01), item('e', 0)]);
    expect([costly.map((i) => i.what).join(''), free.map((i) => i.what).join('')]).toEqual(['dcb', 'ae']);
  });
});
