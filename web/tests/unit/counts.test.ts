import { describe, expect, it } from 'vitest';

import { colourMap, SATURATED_RGB } from '../../src/lib/colourmap';
import { binned, countStatistics, levelFraction, paintCounts, usedRange, WHOLE_RANGE } from '../../src/lib/counts';

/** CIE lightness of an sRGB colour (IEC 61966-2-1, CIE 15). */
function lightness(r: number, g: number, b: number): number {
  const linear = [r, g, b].map((c) => (c / 255 <= 0.04045 ? c / 255 / 12.92 : ((c / 255 + 0.055) / 1.055) ** 2.4));
  const y = 0.2126 * (linear[0] ?? 0) + 0.7152 * (linear[1] ?? 0) + 0.0722 * (linear[2] ?? 0);
  return y > 216 / 24389 ? 116 * Math.cbrt(y) - 16 : (y * 24389) / 27;
}

describe('colourMap', () => {
  it('viridis grows in lightness with every step, evenly', () => {
    const map = colourMap('viridis');
    const l = Array.from({ length: 256 }, (_, i) => lightness(map[3 * i] ?? 0, map[3 * i + 1] ?? 0, map[3 * i + 2] ?? 0));
    const steps = l.slice(1).map((v, i) => v - (l[i] ?? 0));
    const mean = ((l[255] ?? 0) - (l[0] ?? 0)) / 255;
    // Rounding to bytes moves a step by some tenths of its size; sixteen of them together do not.
    expect(Math.min(...steps)).toBeGreaterThan(-0.05);
    for (let i = 0; i + 16 < 256; i++) expect(((l[i + 16] ?? 0) - (l[i] ?? 0)) / 16 / mean).toBeGreaterThan(0.75);
  });
});

describe('countStatistics', () => {
  const frame = { width: 4, height: 2, pixels: Uint16Array.from([10, 20, 20, 20, 30, 40, 65535, 65535]) };

  it('agrees with a count by hand', () => {
    const s = countStatistics(frame, 65535);
    expect([s.min, s.max, s.median, s.saturated]).toEqual([10, 65535, 20, 2]);
    expect(s.mean).toBeCloseTo((10 + 60 + 30 + 40 + 2 * 65535) / 8, 9);
    const bins = binned(s.counts, WHOLE_RANGE);
    expect([bins[0], bins[255], bins.reduce((a, b) => a + b, 0)]).toEqual([6, 2, 8]);
  });

  it('has a histogram of the used counts, which a hot pixel does not widen', () => {
    const pixels = Uint16Array.from({ length: 2000 }, (_, i) => 190 + (i % 31));
    pixels[7] = 65535;
    const s = countStatistics({ width: 2000, height: 1, pixels }, 65535);
    const range = usedRange(s);
    expect(range.from).toBeGreaterThan(150);
    expect(range.to).toBeLessThan(260);
    const bins = binned(s.counts, range);
    expect(bins.length).toBe(range.to - range.from);
    expect(bins.reduce((a, b) => a + b, 0)).toBe(1999);
  });

  it('gives levels that differ even in a uniform frame', () => {
    const s = countStatistics({ width: 2, height: 1, pixels: Uint16Array.from([500, 500]) }, 65535);
    expect([s.autoLow, s.autoHigh]).toEqual([500, 501]);
  });
});

describe('paintCounts', () => {
  it('clips at the levels and marks saturated pixels', () => {
    const frame = { width: 4, height: 1, pixels: Uint16Array.from([0, 100, 300, 65535]) };
    const rgba = paintCounts(frame, { low: 100, high: 300, scale: 'linear' }, 'viridis', 65535, true);
    const map = colourMap('viridis');
    const at = (i: number): number[] => [...rgba.subarray(4 * i, 4 * i + 3)];
    expect(at(0)).toEqual([...map.subarray(0, 3)]);
    expect(at(1)).toEqual([...map.subarray(0, 3)]);
    expect(at(2)).toEqual([...map.subarray(765, 768)]);
    expect(at(3)).toEqual([...SATURATED_RGB]);
  });

  it('spreads the dark end on a logarithmic scale, ends unmoved', () => {
    const levels = { low: 100, high: 10100, scale: 'log' } as const;
    expect(levelFraction(100, levels)).toBe(0);
    expect(levelFraction(10100, levels)).toBe(1);
    expect(levelFraction(200, levels)).toBeCloseTo(Math.log(101) / Math.log(10001), 12);
  });
});
