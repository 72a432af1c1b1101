// Control chart of individual values with moving ranges (I-MR), and two rules of the Western Electric handbook.
//
// Sources: NIST/SEMATECH e-Handbook of Statistical Methods, 6.3.2.2 (individuals control charts) and 6.3.2 (Western Electric
// rules); ISO 7870-2:2013. A moving range is that of two consecutive values.

/** d2 and D4 for ranges of two values. */
const [D2, D4] = [1.128, 3.267];
/** Values in a row on one side of the mean that are a signal. */
export const RUN = 8;

export interface ControlLimits {
  readonly n: number;
  readonly mean: number;
  /** Mean moving range over d2: the scatter from one value to the next. */
  readonly s: number;
  /** Mean ± 3 s. */
  readonly lower: number;
  readonly upper: number;
  readonly meanRange: number;
  readonly rangeUpper: number;
}

/** Absolute differences of consecutive values; one less than values. */
export function movingRanges(values: readonly number[]): number[] {
  return values.slice(1).map((x, i) => Math.abs(x - (values[i] ?? 0)));
}

/** Null with fewer than two values. */
export function controlLimits(values: readonly number[]): ControlLimits | null {
  if (values.length < 2) return null;
  const average = (list: readonly number[]): number => list.reduce((sum, x) => sum + x, 0) / list.length;
  const [mean, meanRange] = [average(values), average(movingRanges(values))];
  const s = meanRange / D2;
  return { n: values.length, mean, s, lower: mean - 3 * s, upper: mean + 3 * s, meanRange, rangeUpper: D4 * meanRange };
}

export interface Signals {
  /** Western Electric rule 1: the value is beyond mean ± 3 s. */
  readonly beyond: readonly boolean[];
  /** The value belongs to a run of at least eight on one side of the mean. */
  readonly inRun: readonly boolean[];
  /** First and last value of each such run, from 0. */
  readonly runs: readonly { readonly from: number; readonly to: number; readonly above: boolean }[];
}

export function signalsOf(values: readonly number[], limits: Pick<ControlLimits, 'mean' | 'lower' | 'upper'>): Signals {
  const runs: { from: number; to: number; above: boolean }[] = [];
  let from = 0;
  const side = (i: number): number => Math.sign((values[i] ?? limits.mean) - limits.mean);
  for (let i = 1; i <= values.length; i++) {
    if (i < values.length && side(i) === side(from)) continue;
    // A value on the mean is on neither side.
    if (side(from) !== 0 && i - from >= RUN) runs.push({ from, to: i - 1, above: side(from) > 0 });
    from = i;
  }
  return {
    beyond: values.map((x) => x < limits.lower || x > limits.upper),
    inRun: values.map((_, i) => runs.some((run) => i >= run.from && i <= run.to)),
    runs,
  };
}
