import { describe, expect, it } from 'vitest';

import { conformance, judged, risksOf } from '../../src/lib/conformity';

const RISKS = risksOf(null);

describe('conformity', () => {
  it('has the probabilities of a normal distribution', () => {
    // Φ(1) = 0.841345, Φ(1.959964) = 0.975.
    expect(conformance(10, 0.5, { upper: 10.5 })).toBeCloseTo(0.841345, 6);
    expect(conformance(10, 0.5, { lower: 9.5, upper: 10.5 })).toBeCloseTo(0.682689, 6);
    expect(conformance(10, 0.5, { lower: 10 + 0.5 * 1.959964 })).toBeCloseTo(0.025, 6);
    expect(conformance(10, 0, { lower: 10 })).toBe(1);
    expect(conformance(9.9, 0, { lower: 10 })).toBe(0);
  });

  it('passes and fails at the risks of the specification', () => {
    const limits = { lower: 9, upper: 11 };
    expect(judged(10, 0.1, limits, RISKS)).toBe('pass');
    expect(judged(10.9, 0.1, limits, RISKS)).toBe('cannot-tell');
    expect(judged(10.9, 0.1, limits, { accept: 0.2, reject: 0.025 })).toBe('pass');
    expect(judged(11.3, 0.1, limits, RISKS)).toBe('fail');
  });
});
