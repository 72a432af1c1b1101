import { describe, expect, it } from 'vitest';

import { axisOf, histogram, judgedPixels, quantile, regionOf, sharesOf, sortedValues, summaryOf, usualRange, valuesIn, wholeRange } from '../../src/lib/mapvalues';

const raster = { width: 4, height: 3, values: Float32Array.from([1, 2, 3, 4, 5, 6, 7, 8, 9, 10, Number.NaN, 12]) };

describe('the colour range of a map', () => {
  it('is the 1st to the 99th percentile, or the whole range', () => {
    const sorted = Float32Array.from({ length: 101 }, (_, i) => i);
    expect(usualRange(sorted)).toEqual({ from: 1, to: 99 });
    expect(wholeRange(sorted)).toEqual({ from: 0, to: 100 });
    // The axis has half of the width on each side where there are values.
    expect(axisOf(sorted, { from: 1, to: 99 })).toEqual({ from: 0, to: 100 });
    expect(axisOf(Float32Array.from([0, ...Array.from({ length: 300 }, (_, i) => 100 + i / 100), 900]), { from: 100, to: 103 }).to).toBeLessThan(106);
    expect(axisOf(sorted, { from: -10, to: 99 }).from).toBe(-10);
  });

  it('has room where all pixels are the same, and exists without a value', () => {
    const same = usualRange(Float32Array.from([2, 2, 2]));
    expect([same.from, same.to]).toEqual([1.9, 2.1]);
    expect(usualRange(new Float32Array())).toEqual({ from: 0, to: 1 });
  });
});

describe('statistics of a map', () => {
  it('quantiles lie between the nearest values', () => {
    expect(sortedValues(Float32Array.from([3, Number.NaN, 1, 2]))).toEqual(Float32Array.from([1, 2, 3]));
    expect([0, 0.25, 0.5, 1].map((share) => quantile([1, 2, 4], share))).toEqual([1, 1.5, 2, 4]);
    expect(quantile([], 0.5)).toBeNaN();
  });

  it('a histogram counts each value of the range once', () => {
    expect(histogram([0, 0.5, 1, 1.99, 2, -1, 3, Number.NaN], { from: 0, to: 2 }, 4)).toEqual([1, 1, 1, 2]);
  });

  it('a region has its last column and row, and stays in the map', () => {
    expect(regionOf({ x: 2, y: 2 }, { x: 1, y: -5 }, raster)).toEqual({ left: 1, top: 0, right: 2, bottom: 2 });
    expect(valuesIn(raster, { left: 1, top: 1, right: 2, bottom: 2 })).toEqual([6, 7, 10]);
  });

  it('mean, scatter and percentiles agree with values by hand', () => {
    // 2, 4, 4, 4, 5, 5, 7, 9: mean 5, sum of squares 32.
    expect(summaryOf([2, 4, 4, 4, 5, 5, 7, 9])).toEqual({ n: 8, mean: 5, deviation: Math.sqrt(32 / 7), p5: 2.7, median: 4.5, p95: expect.closeTo(8.3, 12) as number });
    expect(summaryOf([3])).toMatchObject({ n: 1, mean: 3, deviation: null });
    expect(summaryOf([])).toBeNull();
  });

  it('directions are counted around their mean direction', () => {
    const around = summaryOf([178, -178, 180], true);
    expect(Math.abs(around?.mean ?? 0)).toBeCloseTo(180, 9);
    expect(around?.deviation).toBeCloseTo(2, 9);
  });
});

describe('pixels within limits', () => {
  it('pass, fail or are not decided by their own and the common uncertainty', () => {
    const values = Float32Array.from([10, 10.95, 11.05, 11.5, Number.NaN, 10]);
    const std = Float32Array.from([0.1, 0.1, 0.1, 0.1, 0.1, Number.NaN]);
    const limits = { lower: 9, upper: 11 };
    const risks = { accept: 0.025, reject: 0.025 };
    const classes = judgedPixels(values, std, null, limits, risks);
    expect([...classes]).toEqual([1, 3, 3, 2, 0, 0]);
    expect(sharesOf(classes, 3, null)).toEqual({ n: 4, pass: 0.25, fail: 0.25, 'cannot-tell': 0.5 });
    expect(sharesOf(classes, 3, { left: 0, top: 0, right: 0, bottom: 1 })).toEqual({ n: 2, pass: 0.5, fail: 0.5, 'cannot-tell': 0 });
    // A common uncertainty of 0.5° leaves the last one open.
    expect([...judgedPixels(values, std, 0.5, limits, risks)]).toEqual([3, 3, 3, 3, 0, 0]);
  });
});
