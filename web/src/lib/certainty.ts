// The expanded uncertainty of the ridge angle during a scan, from the rows of the live fit.

import type { Certainty } from './types';

type Known = Certainty['parameters'][string];

/** The coverage factor of a value during the scan. Rows of older data folders lack it. */
export const coverageOf = (value: Known): number => value.coverage_factor ?? 2;

/** Its expanded uncertainty. */
export const expandedOf = (value: Known): number => coverageOf(value) * value.std;

/** Rows of both lists by the rig's time, without duplicates. */
export function merged(kept: readonly Certainty[], fresh: readonly Certainty[]): Certainty[] {
  const rows = new Map([...kept, ...fresh].map((row) => [row.id, row]));
  return [...rows.values()].sort((a, b) => a.elapsed_s - b.elapsed_s || a.id - b.id);
}

/** Whether the frames of a row determined the ridge angle. */
const isKnown = (row: Certainty): boolean => row.parameters['theta_r_deg'] !== undefined;

/** Expanded uncertainty of the ridge angle, degrees; null while the frames did not determine it. */
export function expandedAngle(row: Certainty): number | null {
  const angle = row.parameters['theta_r_deg'];
  return angle === undefined ? null : expandedOf(angle);
}

/** The newest row that determines the ridge angle. */
export function newestKnown(rows: readonly Certainty[]): Certainty | null {
  return rows.findLast(isKnown) ?? null;
}

/** The first row from which on the uncertainty of the ridge angle stays within the target; null if the newest is beyond it. */
export function reachedAt(rows: readonly Certainty[], target: number): Certainty | null {
  const known = rows.filter(isKnown);
  const beyond = known.findLastIndex((row) => (expandedAngle(row) ?? Infinity) > target);
  return known[beyond + 1] ?? null;
}

interface LogarithmicScale {
  readonly low: number;
  readonly high: number;
  /** Labelled marks: 1, 2 and 5 of each decade, or powers of ten if those are many. */
  readonly marks: readonly number[];
}

const MARKS_MAX = 7;

/** A logarithmic scale that contains all values with a margin, from one round value to another.
 *
 * The marks are computed here: uPlot's own loop does not end when the lower end is between 9.5 and 10 of its decade. */
export function logarithmic(values: readonly (number | null)[]): LogarithmicScale {
  const all = values.filter((s): s is number => s !== null && s > 1e-300 && s < 1e300);
  const [least, most] = all.length === 0 ? [1e-3, 1] : [Math.min(...all) / 1.1, Math.max(...all) * 1.1];
  const exponents = [Math.floor(Math.log10(least)) - 1, Math.ceil(Math.log10(most)) + 1] as const;
  const round = Array.from({ length: exponents[1] - exponents[0] + 1 }, (_, i) => [1, 2, 5].map((m) => Number(`${m}e${exponents[0] + i}`))).flat();
  const low = round.findLast((x) => x <= least) ?? least;
  const high = round.find((x) => x >= most) ?? most;
  const marks = round.filter((x) => x >= low && x <= high);
  if (marks.length <= MARKS_MAX) return { low, high, marks };
  const step = Math.ceil(Math.log10(high / low) / MARKS_MAX);
  const powers = marks.filter((x) => x.toExponential(0).startsWith('1e') && Math.round(Math.log10(x)) % step === 0);
  return { low, high, marks: powers };
}

interface TimeScale {
  readonly unit: 's' | 'min';
  /** Of one unit. */
  readonly seconds: number;
  /** The right end, in units. */
  readonly high: number;
  readonly marks: readonly number[];
}

/** Below this time, in s, the axis is in seconds. */
const SECONDS_BELOW = 120;
const TIME_MARKS_MAX = 8;

/** A scale of the rig's time from 0 to the newest row, with at most eight round marks. */
export function timeScale(latestS: number): TimeScale {
  const seconds = latestS < SECONDS_BELOW ? 1 : 60;
  const high = (Math.max(latestS, 1) / seconds) * 1.03;
  const steps = [-1, 0, 1, 2, 3, 4].flatMap((e) => [1, 2, 5].map((m) => Number(`${m}e${e}`)));
  const step = steps.find((s) => Math.floor(high / s) + 1 <= TIME_MARKS_MAX) ?? high;
  return { unit: seconds === 1 ? 's' : 'min', seconds, high, marks: Array.from({ length: Math.floor(high / step) + 1 }, (_, i) => Number((i * step).toPrecision(9))) };
}
