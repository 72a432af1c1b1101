// Two results beside each other: the difference of two curves. The daemon compares the parameters.

import type { Curves } from './types';

/** Poses nearer than this are the same: stages read back within a few thousandths of a degree. */
const SAME_DEG = 0.25;

interface ComparedPoint {
  readonly phi_s_deg: number;
  readonly signal: number;
  readonly sigma: number;
}

export interface ComparedPanel {
  readonly theta_c_deg: number;
  readonly points: readonly [readonly ComparedPoint[], readonly ComparedPoint[]];
  readonly curves: readonly [readonly { readonly x: number; readonly y: number }[], readonly { readonly x: number; readonly y: number }[]];
  /** Second minus first at poses of both, with the standard uncertainty of the difference by counting. */
  readonly differences: readonly ComparedPoint[];
}

/** One panel per tilt of either scan, ascending. */
export function comparedPanels(first: Curves, second: Curves): ComparedPanel[] {
  const tilts: number[] = [];
  for (const tilt of [...first.observations, ...second.observations].map((o) => o.theta_c_deg).sort((a, b) => a - b)) {
    if (tilts.length === 0 || tilt - (tilts.at(-1) ?? 0) > SAME_DEG) tilts.push(tilt);
  }
  const near = (a: number, b: number): boolean => Math.abs(a - b) <= SAME_DEG;
  return tilts.map((theta_c_deg) => {
    const pointsOf = (data: Curves): ComparedPoint[] => data.observations.filter((o) => near(o.theta_c_deg, theta_c_deg)).map(({ phi_s_deg, signal, sigma }) => ({ phi_s_deg, signal, sigma })).sort((a, b) => a.phi_s_deg - b.phi_s_deg);
    // The first curve is that of the fit itself.
    const own = (data: Curves): { x: number; y: number }[] => {
      const curve = data.curves.find((c) => c.variant === data.curves[0]?.variant && near(c.theta_c_deg, theta_c_deg));
      return (curve?.phi_s_deg ?? []).map((x, i) => ({ x, y: curve?.signal[i] ?? 0 }));
    };
    const points = [pointsOf(first), pointsOf(second)] as const;
    const differences = points[1].flatMap((b) => {
      const a = points[0].find((p) => near(p.phi_s_deg, b.phi_s_deg));
      return a ? [{ phi_s_deg: b.phi_s_deg, signal: b.signal - a.signal, sigma: Math.hypot(a.sigma, b.sigma) }] : [];
    });
    return { theta_c_deg, points, curves: [own(first), own(second)], differences };
  });
}
