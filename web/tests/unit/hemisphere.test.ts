import { describe, expect, it } from 'vitest';

import { aopField, binAt, Bins, brightnessScale, decadeAbove, differenceFields, dolpField, greatest, marksOf, middleOf, placeOf, placeOn, ratioField, roundAbove, stokesField, type Field, type Scale } from '../../src/lib/hemisphere';

const NAMES = Array.from({ length: 16 }, (_, i) => `m${Math.floor(i / 4)}${i % 4}`);
/** Two by two bins, one side; element i of every lit bin is (i + 1)/16 ± 0.01, bin 3 is dark. */
function block(): ArrayBuffer {
  const numbers = new Float32Array(4 * 16 * 2).fill(Number.NaN);
  for (let bin = 0; bin < 3; bin++) for (let i = 0; i < 16; i++) numbers.set([(i + 1) / 16, 0.01], 2 * (16 * bin + i));
  return numbers.buffer;
}
const of = { n_theta: 2, n_phi: 2, sides: ['reflected'], numbers: NAMES };
const field = (values: number[], std = 0): Field => ({ values: new Float32Array(values), stds: new Float32Array(values.map(() => std)) });

describe('direction bins', () => {
  it('are read by side and name, and a file of another length is refused', () => {
    const bins = new Bins(of, block());
    expect([...bins.field('reflected', 'm01').values].slice(0, 3)).toEqual([0.125, 0.125, 0.125]);
    expect(bins.field('reflected', 'm01').values[3]).toBeNaN();
    expect(bins.field('transmitted', 'm01').values.every(Number.isNaN)).toBe(true);
    expect(() => new Bins({ ...of, n_phi: 3 }, block())).toThrow('damaged');
  });

  it('give the Stokes vector of any lamp, its error from the elements', () => {
    const bins = new Bins(of, block());
    const q = stokesField(bins, 'reflected', 1, [1, -1, 0, 0]);
    expect(q.values[0]).toBeCloseTo(-1 / 16, 6);
    expect(q.stds[0]).toBeCloseTo(Math.SQRT2 * 0.01, 6);
  });

  it('have no ratio, degree or angle if the brightness or the polarisation is noise', () => {
    const bright = field([1, 1, 0.1], 0.05);
    expect([...ratioField(field([0.5, -1, 1]), bright).values]).toEqual([0.5, -1, Number.NaN]);
    const [q, u] = [field([0.3, 0, 0.1]), field([0.4, 0, 0])];
    expect(dolpField(bright, q, u).values[0]).toBeCloseTo(0.5, 6);
    const aop = aopField(field([1, 1, 1]), field([0, -0.5, 0.001]), field([0.5, 0, 0]));
    expect([...aop.values].map((x) => Math.round(x))).toEqual([45, 90, Number.NaN]);
  });

  it('read the four numbers of a comparison', () => {
    const { mean, adm, mdm } = differenceFields(new Float32Array([-0.1, 0.01, 0.2, 0.3, Number.NaN, Number.NaN, Number.NaN, Number.NaN]).buffer);
    expect([mean.values[0], mean.stds[0], adm.values[0], mdm.values[0]].map((x) => Number((x ?? 0).toFixed(3)))).toEqual([-0.1, 0.01, 0.2, 0.3]);
    expect(mean.values[1]).toBeNaN();
  });
});

describe('places on a disc', () => {
  it('are the inverse of bins', () => {
    for (let bin = 0; bin < 9 * 12; bin++) {
      const { theta_deg, phi_deg } = middleOf(bin, 9, 12);
      const { x, y } = placeOf(theta_deg, phi_deg);
      expect(binAt(x, y, 9, 12)).toBe(bin);
    }
    expect(binAt(0.8, 0.7, 9, 12)).toBeNull();
  });
});

describe('a scale', () => {
  const log: Scale = { kind: 'log', palette: 'diverging', top: 10 };
  it('is symmetric about zero, with its limits at the ends', () => {
    for (const scale of [log, { ...log, kind: 'linear' } as Scale]) {
      expect(placeOn(scale, 0)).toBe(0.5);
      expect([placeOn(scale, 10), placeOn(scale, -10)].map((x) => x.toFixed(9))).toEqual(['1.000000000', '0.000000000']);
      expect(placeOn(scale, 3) + placeOn(scale, -3)).toBeCloseTo(1, 12);
    }
  });

  it('has equal steps for powers of ten', () => {
    const [a, b, c] = [10, 1, 0.1].map((x) => placeOn(log, x));
    expect((a ?? 0) - (b ?? 0)).toBeCloseTo((b ?? 0) - (c ?? 0), 2);
    expect(marksOf(log)).toEqual([-10, -1, -0.1, 0, 0.1, 1, 10]);
  });

  it('of a brightness is unsigned: from the lowest lit decade to the top', () => {
    const scale = brightnessScale([field([3, 0.02, 0, Number.NaN])], 'log');
    expect(scale).toEqual({ kind: 'log', palette: 'sequential', top: 10, bottom: 0.01 });
    expect(marksOf(scale)).toEqual([0.01, 0.1, 1, 10]);
    expect([0, 0.01, 1, 10].map((x) => Number(placeOn(scale, x).toFixed(6)))).toEqual([0, 0, 0.666667, 1]);
    expect(brightnessScale([field([3, 0.02])], 'linear')).toEqual({ kind: 'linear', palette: 'sequential', top: 3 });
    expect(brightnessScale([field([1, 1e-12])], 'log').bottom).toBeCloseTo(1e-6, 12);
    expect(brightnessScale([field([0.5])], 'log')).toEqual({ kind: 'log', palette: 'sequential', top: 1, bottom: 0.1 });
    expect(brightnessScale([field([0])], 'log').bottom).toBe(0.1);
  });

  it('ends at a round value above the greatest value that is not noise', () => {
    expect(greatest(field([0.2, -3, 0.5], 0.01))).toBe(3);
    expect(greatest(field([0.2, -3, 0.5], 2))).toBe(0);
    expect([decadeAbove(3), decadeAbove(10), decadeAbove(0.02), decadeAbove(0)]).toEqual([10, 10, 0.1, 1]);
    expect([roundAbove(3.1), roundAbove(2), roundAbove(0.07)].map((x) => Number(x.toPrecision(6)))).toEqual([5, 2, 0.1]);
  });
});
