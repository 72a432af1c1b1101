import { describe, expect, it } from 'vitest';

import { difference, withoutLines } from '../../src/lib/compare';
import { chiSquareTail, consistency, erfc } from '../../src/lib/statistics';
import type { Parameter } from '../../src/lib/types';

describe('chiSquareTail', () => {
  it('gives the 5 % points of the tables, and the closed forms', () => {
    // NIST/SEMATECH e-Handbook, table 1.3.6.7.4.
    for (const [dof, point] of [[1, 3.841], [2, 5.991], [3, 7.815], [4, 9.488], [9, 16.919], [30, 43.773]] as const) expect(chiSquareTail(point, dof)).toBeCloseTo(0.05, 4);
    expect(chiSquareTail(0, 5)).toBe(1);
    expect(chiSquareTail(6, 2)).toBeCloseTo(Math.exp(-3), 14);
  });

  it('has an erfc that is smooth where its two forms meet', () => {
    expect(erfc(1)).toBeCloseTo(0.15729920705028513, 14);
    expect(erfc(3) / 2.209049699858544e-5).toBeCloseTo(1, 10);
    expect(erfc(2.5 - 1e-9) / erfc(2.5 + 1e-9)).toBeCloseTo(1, 7);
  });
});

describe('consistency', () => {
  it('compares the scatter with the stated uncertainty', () => {
    const c = consistency([9, 10, 11].map((value) => ({ value, std: 1 })));
    expect([c.mean, c.deviation, c.stated, c.chiSquare, c.degreesOfFreedom]).toEqual([10, 1, 1, 2, 2]);
    expect(c.probability).toBeCloseTo(Math.exp(-1), 12);
    expect(consistency([{ value: 1, std: 0 }, { value: 2, std: 1 }]).probability).toBeNull();
  });
});

describe('the difference of two results', () => {
  const parameter = (value: number, counting: number, reference: number): Parameter => {
    const std = Math.hypot(counting, reference);
    return { value, std, expanded: 2 * std, coverage_factor: 2, identifiable: true, budget: { counting, reference } } as Parameter;
  };

  it('takes lines as independent unless they are named as shared', () => {
    const [a, b] = [parameter(10, 0.3, 0.4), parameter(11, 0.3, 0.4)];
    const independent = difference(a, b, []);
    expect(independent?.expanded).toBeCloseTo(2 * Math.sqrt(0.5), 12);
    expect(independent?.normalised).toBeCloseTo(1 / (2 * Math.sqrt(0.5)), 12);
    const shared = difference(a, b, ['reference']);
    expect(shared?.expanded).toBeCloseTo(2 * Math.hypot(0.3, 0.3), 12);
    // Of a shared line the difference of its contributions remains.
    expect(difference(a, parameter(11, 0.3, 0.1), ['reference'])?.expanded).toBeCloseTo(2 * Math.hypot(0.3, 0.3, 0.3), 12);
  });

  it('is missing with a value, and a parameter has its uncertainty without some lines', () => {
    expect(difference(undefined, parameter(1, 1, 1), [])).toBeNull();
    expect(withoutLines(parameter(1, 3, 4), [])).toBeCloseTo(5, 12);
    expect(withoutLines(parameter(1, 3, 4), ['reference'])).toBeCloseTo(3, 12);
  });
});
