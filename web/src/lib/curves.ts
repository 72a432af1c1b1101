// Observations and curves, sorted into one panel per camera tilt.

import type { CurvePoint, Curves } from './types';

interface PanelCurve {
  readonly variant: string;
  readonly phi_s_deg: readonly number[];
  readonly signal: readonly number[];
}

export interface Panel {
  readonly theta_c_deg: number;
  /** By azimuth, ascending. */
  readonly points: readonly CurvePoint[];
  readonly curves: readonly PanelCurve[];
}

/** Tilts closer than this share a panel: stages read back within a few thousandths of a degree. */
const SAME_TILT_DEG = 0.25;

/** Panels by ascending tilt: one per tilt of the plan from the start, and one per further tilt of the observations. A curve goes
 *  to the panel with the nearest tilt. */
export function panels(data: Curves, plannedTilts: readonly number[] = []): Panel[] {
  const groups: { theta_c_deg: number; points: CurvePoint[]; curves: PanelCurve[] }[] = [];
  const tilts = [...plannedTilts.map((theta_c_deg) => ({ theta_c_deg, point: null })), ...data.observations.map((point) => ({ theta_c_deg: point.theta_c_deg, point }))];
  for (const { theta_c_deg, point } of tilts.sort((a, b) => a.theta_c_deg - b.theta_c_deg)) {
    let last = groups.at(-1);
    if (!last || theta_c_deg - last.theta_c_deg > SAME_TILT_DEG) {
      last = { theta_c_deg, points: [], curves: [] };
      groups.push(last);
    }
    if (point) last.points.push(point);
  }
  for (const curve of data.curves) {
    const nearest = groups.reduce<(typeof groups)[number] | null>((best, group) => {
      const distance = Math.abs(group.theta_c_deg - curve.theta_c_deg);
      return best === null || distance < Math.abs(best.theta_c_deg - curve.theta_c_deg) ? group : best;
    }, null);
    if (nearest && Math.abs(nearest.theta_c_deg - curve.theta_c_deg) <= SAME_TILT_DEG) nearest.curves.push(curve);
  }
  return groups.map((group) => ({
    theta_c_deg: group.points.length === 0 ? group.theta_c_deg : group.points.reduce((sum, p) => sum + p.theta_c_deg, 0) / group.points.length,
    points: group.points.sort((a, b) => a.phi_s_deg - b.phi_s_deg),
    curves: group.curves,
  }));
}

/**
 * The model discrepancy along the azimuth, as a share of that at the peak. The fit assumes that it is
 * proportional to the signal plus a tenth of the peak (`fit::estimate`).
 */
export function inadequacyShape(panel: Panel, variant: string, peak: number): { x: number; share: number }[] {
  const curve = panel.curves.find((c) => c.variant === variant);
  const along = curve
    ? curve.phi_s_deg.map((x, i) => ({ x, y: curve.signal[i] ?? 0 }))
    : panel.points.map((p) => ({ x: p.phi_s_deg, y: p.predicted ?? p.signal }));
  return along.map(({ x, y }) => ({ x, share: (Math.abs(y) + 0.1 * peak) / (1.1 * peak) }));
}

/** Variants that have a curve, the fit's own first. */
export function variantsOf(data: Curves): string[] {
  return [...new Set(data.curves.map((c) => c.variant))];
}

/** Columns for uPlot: one common ascending x, then one column per (xs, ys), null where it has no value. */
export function aligned(columns: readonly { readonly xs: readonly number[]; readonly ys: readonly (number | null)[] }[]): {
  xs: number[];
  columns: (number | null)[][];
} {
  const xs = [...new Set(columns.flatMap((c) => c.xs))].sort((a, b) => a - b);
  const index = new Map(xs.map((x, i) => [x, i]));
  return {
    xs,
    columns: columns.map((column) => {
      const out = new Array<number | null>(xs.length).fill(null);
      column.xs.forEach((x, i) => {
        out[index.get(x) ?? 0] = column.ys[i] ?? null;
      });
      return out;
    }),
  };
}

/** The range of the azimuth axis, degrees, for all panels and for the whole scan: a full turn, and the plan where it goes beyond. */
export function azimuthRange(planned: readonly number[]): [number, number] {
  const [low, high] = [Math.min(0, ...planned), Math.max(360, ...planned)];
  return [low - 8, high + 8];
}

/** Round azimuths within a range, degrees: quarter turns, or smaller steps if the range contains few of those. */
export function azimuthMarks(low: number, high: number): number[] {
  const step = [90, 30, 10, 5, 1].find((s) => (high - low) / s >= 2.1) ?? 0.5;
  const first = Math.ceil(low / step - 1e-9);
  return Array.from({ length: Math.max(0, Math.floor(high / step + 1e-9) - first + 1) }, (_, i) => (first + i) * step || 0);
}
