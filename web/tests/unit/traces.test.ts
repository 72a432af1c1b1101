import { describe, expect, it } from 'vitest';

import { brightest, panelsOf, readingsOf, strokes } from '../../src/lib/plane';
import { estimateWords, traceFaults, EXAMPLES, hasRidges, ordersOf, titleOf, typedCount, withoutCommands } from '../../src/lib/scenes';
import type { TracePlane } from '../../src/lib/types';

describe('an example', () => {
  it('has its title and no command line', () => {
    expect(withoutCommands('# Gold.\n#   ridged trace x.toml --out y\n\n[light]\n')).toBe('# Gold.\n\n[light]\n');
    for (const { text } of EXAMPLES) expect(text).not.toMatch(/ridged /);
  });
});

describe('a scene', () => {
  it('is named by its first comment, else by its shapes from the top down', () => {
    expect(titleOf('# Gold, rough.\n[light]')).toBe('Gold, rough');
    expect(titleOf('[[interface]]\nshape = "flat"\n[[interface]]\n shape = "beckmann"\n')).toBe('flat over beckmann');
    expect(titleOf({ interface: [{ shape: 'ridges' }] })).toBe('ridges');
    expect(titleOf('')).toBe('scene');
    expect([{ interface: [{ shape: 'ridges' }] }, 'shape = "profile"', 'shape = "beckmann"', null].map(hasRidges)).toEqual([true, true, false, false]);
    expect(EXAMPLES.map((e) => e.text.includes('[[interface]]'))).toEqual(EXAMPLES.map(() => true));
  });

  it('reads photon numbers in common notations', () => {
    expect(['1e6', '1 000 000', '1_000_000', '1.5e3', ''].map(typedCount)).toEqual([1e6, 1e6, 1e6, 1500, null]);
    expect(['-1', '0', '1.5', 'many'].map(typedCount)).toEqual([Number.NaN, Number.NaN, Number.NaN, Number.NaN]);
  });
});

describe('energies by interactions', () => {
  it('are in order, with small ones summed', () => {
    const e = (value: number) => ({ value, std: 1e-5 });
    const orders = ordersOf({ R1: e(0.1), R10: e(2e-4), R16plus: e(0.02), R2: e(0.3), T1: e(3e-4), T2: e(0) });
    expect(orders.map((o) => `${o.letter}${o.order}`)).toEqual(['R1', 'R2', 'R16+', '']);
    expect(orders.at(-1)?.value).toBeCloseTo(5e-4, 12);
    expect(orders.at(-1)?.std).toBeCloseTo(Math.SQRT2 * 1e-5, 12);
    expect(ordersOf({ R1: e(1e-4) }).map((o) => o.order)).toEqual(['1']);
  });
});

describe('the plane of incidence', () => {
  const reading = (dolp: number, std: number) => ({ stokes: [1, dolp, 0, 0], stokes_std: [0.01, std, 0, 0], dolp, aop_deg: 0 });
  const plane = (lobe: TracePlane['lobe']): TracePlane => ({
    states: [{ name: 'scene', stokes: [1, 0, 0, 0] }],
    points: [
      { theta_s_deg: -10, readings: [reading(0.5, 0.01)] },
      { theta_s_deg: 10, readings: [reading(0.5, 0.3)] },
      { theta_s_deg: 12, readings: [reading(0.005, 0.0001)] },
    ],
    lobe,
  });

  it('omits degrees and angles that are too noisy', () => {
    const [dolp, aop, bright] = panelsOf(plane(null), 0);
    expect(dolp?.lines[0]?.points.map((p) => p.x)).toEqual([-10, 12]);
    // The angle of nearly unpolarised light has no meaning.
    expect(aop?.lines[0]?.points.map((p) => p.x)).toEqual([-10]);
    expect(bright?.lines[0]?.points.length).toBe(3);
  });

  it('uses the errors of degree and angle if they are stated', () => {
    const one: TracePlane = { ...plane(null), points: [{ theta_s_deg: 0, readings: [{ ...reading(0.5, 0.3), dolp_std: 0.02, aop_std_deg: 1.5 }] }] };
    const [dolp, aop] = panelsOf(one, 0);
    expect([dolp?.lines[0]?.points[0]?.half, aop?.lines[0]?.points[0]?.half]).toEqual([0.02, 1.5]);
  });

  it('shows polarised and scalar, and their difference in per cent if it is known', () => {
    const point = (x: number, p: number, s: number, std: number) => ({ theta_s_deg: x, polarised: { value: p, std: 0 }, scalar: { value: s, std: 0 }, difference: { value: p - s, std } });
    const panels = panelsOf(plane([point(40, 0.8, 1, 0.01), point(42, 0.02, 0.01, 0.01)]), 0);
    expect(panels.map((p) => p.key)).toEqual(['dolp', 'aop', 'lobe', 'difference']);
    const [lobe, d] = [panels[2], panels[3]];
    expect(lobe?.lines.map((l) => l.name)).toEqual(['polarised', 'scalar']);
    expect(lobe?.range).toEqual([0.01, 1]);
    expect(d?.lines[0]?.points.map((p) => [p.x, Number(p.y.toFixed(6))])).toEqual([[40, -20]]);
    expect(d?.range).toEqual([-20, 20]);
  });

  it('has readings with uncertainties, without ratios that are not settled', () => {
    const points = [
      { theta_s_deg: 1, readings: [{ stokes: [0.2, -0.1, 0, 0], stokes_std: [0.001, null, 0, 0], dolp: 0.5, dolp_std: 0.005, aop_deg: 90, aop_std_deg: 0.3 }] },
      { theta_s_deg: 3, readings: [{ stokes: [0.3, 0, 0, 0], stokes_std: [0.001, 0.001, 0, 0], dolp: 0.001, dolp_std: 0.003, aop_deg: 12, aop_std_deg: 50 }] },
      { theta_s_deg: 5, readings: [{ stokes: [0.1, 0, 0, 0], stokes_std: [0.1, 0, 0, 0], dolp: 1, dolp_std: null, aop_deg: 0, aop_std_deg: null }] },
    ] as const;
    expect(brightest(points)).toBe(1);
    const [settled, unpolarised, dark] = points.map((p) => readingsOf(p)[0]);
    expect(settled?.stokes.map(estimateWords)).toEqual(['0.2000 ± 0.0020', '−0.1000', '0', '0']);
    expect([settled?.dolp, settled?.aop_deg]).toEqual([{ value: 0.5, std: 0.005 }, { value: 90, std: 0.3 }]);
    expect([unpolarised?.dolp, unpolarised?.aop_deg]).toEqual([{ value: 0.001, std: 0.003 }, null]);
    expect([dark?.dolp, dark?.aop_deg]).toEqual([null, null]);
  });

  it('starts a new line at gaps and where an angle wraps', () => {
    const points = [[0, 80], [2, 89], [4, -88], [10, -80]].map(([x, y]) => ({ x: x ?? 0, y: y ?? 0, half: 0 }));
    expect(strokes(points, 3, 180).map((s) => s.length)).toEqual([2, 1, 1]);
    expect(strokes(points, 3, null).map((s) => s.length)).toEqual([3, 1]);
  });
});

describe('the numbers of a trace', () => {
  it('have one fault each if they are invalid', () => {
    expect(traceFaults({ count: null, limit: 60, target: null, others: null })).toEqual({});
    const faults = traceFaults({ count: Number.NaN, limit: 0, target: -1, others: 5000 });
    expect(Object.keys(faults)).toEqual(['count', 'limit', 'target', 'others']);
    expect(faults.others).toContain('from 2 to 1000');
  });
});
