// What a control chart shows beside its drawing: the parameters, the signals in words, and what is due. The daemon computes it
// (`GET /charts`).

import { fixed, when } from './format';
import type { Due, ResultChart } from './types';

/** Parameters of the results that have an uncertainty. */
export const CHARTED = ['theta_r_deg', 'alpha_u', 'alpha_v', 'rho_d', 'scale', 'background', 'azimuth_offset_deg', 'tilt_offset_deg', 'translucency', 'crest_radius', 'land_share'] as const;
export type Charted = (typeof CHARTED)[number];

export const isCharted = (name: string): name is Charted => (CHARTED as readonly string[]).includes(name);

/** The signals as sentences, the newest first. */
export function signalSentences({ points, limits, runs }: Pick<ResultChart, 'points' | 'limits' | 'runs'>, decimals: number, unit: string): string[] {
  if (limits === null) return [];
  const number = (x: number): string => `${fixed(x, decimals)}${unit}`;
  const beyond = points.flatMap((p, i) =>
    p.beyond ? [{ at: i, text: `Scan ${p.scan_id}: ${number(p.value)} is ${p.value > limits.upper ? 'above' : 'below'} the control limit ${number(p.value > limits.upper ? limits.upper : limits.lower)} (mean ${p.value > limits.upper ? '+' : '−'} 3 s).` }] : [],
  );
  const inRuns = runs.map((run) => ({ at: run.last, text: `Scans ${points[run.first]?.scan_id ?? ''} to ${points[run.last]?.scan_id ?? ''}: ${run.last - run.first + 1} values in a row ${run.is_above ? 'above' : 'below'} the mean.` }));
  return [...beyond, ...inRuns].sort((a, b) => b.at - a.at).map(({ text }) => text);
}

/** When it was last measured and when it is due. */
export function dueSentence({ what, part, last_at, due_at, is_due }: Due, now = new Date()): string {
  const [name, done, were] = what === 'check-standard' ? [`Check standard ${part ?? ''}`, 'measured', 'was'] : ['References', 'taken', 'were'];
  if (last_at === null || due_at === null) return `${name} ${were} never ${done}: due now.`;
  return `${name} ${were} last ${done} ${when(last_at, now)}: due ${is_due ? 'since ' : ''}${when(due_at, now)}.`;
}
