// What a control chart shows of the results: the values of a parameter in the order of their scans, with U and signals.

import { controlLimits, movingRanges, signalsOf, type ControlLimits, type Signals } from './controlchart';
import { fixed } from './format';
import type { ResultRow } from './types';

/** Parameters of the results that have an uncertainty. */
export const CHARTED = ['theta_r_deg', 'alpha_u', 'alpha_v', 'rho_d', 'scale', 'background', 'azimuth_offset_deg', 'tilt_offset_deg', 'translucency', 'crest_radius'] as const;
export type Charted = (typeof CHARTED)[number];

export const isCharted = (name: string): name is Charted => (CHARTED as readonly string[]).includes(name);

export interface ChartPoint {
  readonly row: ResultRow;
  readonly value: number;
  /** Standard uncertainty (k = 1). */
  readonly std: number;
  /** Expanded uncertainty: the daemon's of θr, 2 u of the others. */
  readonly expanded: number;
  /** To the value before; null of the first. */
  readonly range: number | null;
  readonly beyond: boolean;
  readonly inRun: boolean;
}

export interface Chart {
  readonly points: readonly ChartPoint[];
  readonly limits: ControlLimits | null;
  readonly runs: Signals['runs'];
  /** Rows without a converged fit or without this parameter. */
  readonly omitted: number;
}

/** The chart of rows in the order of their scans. */
export function chartOf(rows: readonly ResultRow[], parameter: Charted): Chart {
  const known = rows.flatMap((row) => {
    const [value, std] = [row[parameter], row[`${parameter}_std`]];
    if (row.status !== 'converged' || value == null || std == null) return [];
    return [{ row, value, std, expanded: parameter === 'theta_r_deg' ? (row.theta_r_deg_expanded ?? 2 * std) : 2 * std }];
  });
  const values = known.map((p) => p.value);
  const limits = controlLimits(values);
  const ranges = movingRanges(values);
  const signals = limits === null ? null : signalsOf(values, limits);
  return {
    points: known.map((p, i) => ({ ...p, range: i === 0 ? null : (ranges[i - 1] ?? null), beyond: signals?.beyond[i] ?? false, inRun: signals?.inRun[i] ?? false })),
    limits,
    runs: signals?.runs ?? [],
    omitted: rows.length - known.length,
  };
}

/** The signals as sentences, the newest first. */
export function signalSentences({ points, limits, runs }: Chart, decimals: number, unit: string): string[] {
  if (limits === null) return [];
  const number = (x: number): string => `${fixed(x, decimals)}${unit}`;
  const beyond = points.flatMap((p, i) =>
    p.beyond ? [{ at: i, text: `Scan ${p.row.scan_id}: ${number(p.value)} is ${p.value > limits.upper ? 'above' : 'below'} the control limit ${number(p.value > limits.upper ? limits.upper : limits.lower)} (mean ${p.value > limits.upper ? '+' : '−'} 3 s).` }] : [],
  );
  const inRuns = runs.map((run) => ({ at: run.to, text: `Scans ${points[run.from]?.row.scan_id ?? ''} to ${points[run.to]?.row.scan_id ?? ''}: ${run.to - run.from + 1} values in a row ${run.above ? 'above' : 'below'} the mean.` }));
  return [...beyond, ...inRuns].sort((a, b) => b.at - a.at).map(({ text }) => text);
}
