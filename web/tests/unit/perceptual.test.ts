import { describe, expect, it } from 'vitest';

import { perceptual, STEPS } from '../../src/lib/perceptual';

/** CIE 1976 lightness of a step, a scale independent of the one that the maps are built in. */
function lightness(table: Uint8Array, step: number): number {
  const [r, g, b] = [0, 1, 2].map((c) => {
    const x = (table[3 * step + c] ?? 0) / 255;
    return x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4;
  });
  return 116 * Math.cbrt(0.2126 * (r ?? 0) + 0.7152 * (g ?? 0) + 0.0722 * (b ?? 0)) - 16;
}
const MIDDLE = (STEPS - 1) / 2;

describe('the diverging map', () => {
  it.each([false, true])('is as far from its ground at −x as at x, ever further outwards (dark page: %s)', (dark) => {
    const table = perceptual('diverging', dark);
    const sign = dark ? 1 : -1;
    let before = lightness(table, MIDDLE);
    for (let step = 16; step <= MIDDLE; step += 16) {
      const [low, high] = [lightness(table, MIDDLE - step), lightness(table, MIDDLE + step)];
      // CIE's scale and OKLab's differ most in saturated blue and red.
      expect(Math.abs(low - high)).toBeLessThan(9);
      const nearer = dark ? Math.min(low, high) : Math.max(low, high);
      expect(sign * (nearer - before)).toBeGreaterThan(0);
      before = nearer;
    }
  });

  it('has the daemon’s colours in the light theme', () => {
    // A test of src/colour.rs holds the same numbers.
    const table = perceptual('diverging', false);
    expect([0, MIDDLE, STEPS - 1].map((s) => [...table.slice(3 * s, 3 * s + 3)])).toEqual([[0, 75, 150], [248, 248, 248], [149, 0, 7]]);
  });
});

describe('the other maps', () => {
  it('have even steps, and the cyclic one closes', () => {
    const table = perceptual('sequential', false);
    const steps = [0, 64, 128, 192, 256].map((s) => lightness(table, s));
    for (let i = 1; i < steps.length; i++) expect((steps[i] ?? 0) - (steps[i - 1] ?? 0)).toBeGreaterThan(14);
    const turn = perceptual('cyclic', true);
    expect([...turn.slice(0, 3)]).toEqual([...turn.slice(-3)]);
  });
});
