// `GET /charts` of the mock daemon: the form of the real answer with as much arithmetic as tests of the page need.

type Json = Record<string, unknown>;
interface Limits { readonly lower?: number; readonly upper?: number }
interface Specification { readonly name: string; readonly limits: Readonly<Record<string, Limits>> }
interface Judged extends Limits { readonly quantity: string; readonly acceptance_lower?: number | null; readonly acceptance_upper?: number | null }

interface Source {
  /** Rows that the filters select, oldest first. */
  readonly rows: readonly Json[];
  readonly parameter: string;
  readonly limitsOf: string | null;
  readonly filter: string | null;
  readonly specification: (name: string) => Specification | null;
  readonly verdict: (id: unknown) => Json | undefined;
  readonly due: readonly Json[];
}

const average = (list: readonly number[]): number => list.reduce((sum, x) => sum + x, 0) / list.length;

/** The chart; null where the stated specification is not known. */
export function resultChart({ rows, parameter, limitsOf, filter, specification, verdict, due }: Source): Json | null {
  const known = rows.filter((row) => row['status'] === 'converged' && row[parameter] != null && row[`${parameter}_std`] != null);
  const values = known.map((row) => Number(row[parameter]));
  const ranges = values.slice(1).map((x, i) => Math.abs(x - (values[i] ?? 0)));
  const mean = average(values);
  const s = average(ranges) / 1.128;
  const limits = values.length < 2 ? null : { n: values.length, mean, s, lower: mean - 3 * s, upper: mean + 3 * s, mean_range: average(ranges), range_limit: 3.267 * average(ranges) };
  const runs: { first: number; last: number; is_above: boolean }[] = [];
  const side = (i: number): number => Math.sign((values[i] ?? mean) - mean);
  for (let first = 0, i = 1; i <= values.length; i++) {
    if (i < values.length && side(i) === side(first)) continue;
    if (limits && side(first) !== 0 && i - first >= 8) runs.push({ first, last: i - 1, is_above: side(first) > 0 });
    first = i;
  }
  const stds = known.map((row) => Number(row[`${parameter}_std`]));
  const points = known.map((row, i) => {
    const [value, std, k] = [values[i] ?? 0, stds[i] ?? 0, parameter === 'theta_r_deg' ? Number(row['coverage_factor'] ?? 2) : 2];
    const moving_range = i === 0 ? null : (ranges[i - 1] ?? null);
    return {
      scan_id: row['scan_id'], region: row['region'] ?? null, fit_id: row['fit_id'], part: row['part'], verdict: row['verdict'], verdict_id: row['verdict_id'], specification: row['specification'], created_at: row['created_at'],
      value, std, expanded: k * std, coverage_factor: k, moving_range, beyond: limits !== null && (value < limits.lower || value > limits.upper), in_run: runs.some((run) => i >= run.first && i <= run.last), range_beyond: limits !== null && moving_range !== null && moving_range > limits.range_limit,
    };
  });
  const named = [...new Set(rows.flatMap((row) => (row['specification'] == null ? [] : [String(row['specification'])])))];
  const name = limitsOf ?? filter ?? (named.length === 1 ? (named[0] ?? '') : '');
  const judged = verdict(rows.findLast((row) => row['specification'] === name)?.['verdict_id']);
  const content = specification(name) ?? ((judged?.['request'] as Json | undefined)?.['specification'] as Specification | undefined) ?? null;
  if (content === null && limitsOf) return null;
  return { parameter, limits, points, runs, run_length: 8, omitted: rows.length - known.length, count: rows.length, specification: content && name !== '' ? beside(content, parameter, stds, judged) : null, due };
}

function beside(content: Specification, parameter: string, stds: readonly number[], judged: Json | undefined): Json {
  const { lower = null, upper = null } = content.limits[parameter] ?? {};
  const item = ((judged?.['items'] ?? []) as readonly Judged[]).find((i) => i.quantity === parameter && (i.lower ?? null) === lower && (i.upper ?? null) === upper);
  const median = [...stds].sort((a, b) => a - b)[Math.floor(stds.length / 2)];
  const limited = lower !== null || upper !== null;
  const judgedBand = lower !== null ? (item?.acceptance_lower ?? 0) - lower : (upper ?? 0) - (item?.acceptance_upper ?? 0);
  const by = item ? judgedBand : median === undefined ? null : 1.959964 * median;
  const guard_band = limited ? by : null;
  return {
    name: content.name, lower, upper, guard_band, acceptance_lower: lower === null || guard_band === null ? null : lower + guard_band, acceptance_upper: upper === null || guard_band === null ? null : upper - guard_band,
    guard_basis: guard_band === null ? null : item ? 'verdict' : 'median-uncertainty', verdict_id: item ? judged?.['id'] : null, max_false_accept_risk: 0.025, limited: Object.keys(content.limits),
  };
}
