import { describe, expect, it } from 'vitest';

import { erfc, normalBelow } from '../../src/lib/normal';

describe('normal distribution', () => {
  it('agrees with tables (Abramowitz and Stegun 7.1, 26.2)', () => {
    for (const [z, value] of [[-1, 1.842700792949715], [0, 1], [0.5, 0.4795001221869535], [1, 0.15729920705028513], [2, 0.004677734981047266], [2.5, 4.069520174449589e-4], [3, 2.209049699858544e-5], [6, 2.1519736712498913e-17]] as const) {
      expect(erfc(z) / value).toBeCloseTo(1, 12);
    }
    for (const [z, below] of [[-3, 0.0013498980316300957], [-1.959963984540054, 0.025], [0, 0.5], [1, 0.8413447460685429], [1.959963984540054, 0.975]] as const) {
      expect(normalBelow(z)).toBeCloseTo(below, 13);
    }
  });
});
