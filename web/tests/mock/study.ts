// Comparisons and studies of the mock daemon: the form of the real answers with as much arithmetic as tests of the page need.

type Json = Record<string, unknown>;
interface MockParameter { value: number | null; std: number | null; expanded: number | null; coverage_factor: number | null; budget: Record<string, number> | null }
export interface MockResult { scan: Json; fit: Json }

const SHARED_BY_RECORDS = ['angles', 'model'];
const LINES = ['counting', 'reference', 'angles', 'model'];

const parameters = (of: MockResult): Record<string, MockParameter> => of.fit['parameters'] as Record<string, MockParameter>;
const hypot = (parts: readonly number[]): number => Math.hypot(...parts);

function sharedLines(stated: string | null): { line: string; shared: boolean; why: string }[] {
  const lines = stated === null ? SHARED_BY_RECORDS : stated.split(',');
  return LINES.map((line) => ({ line, shared: lines.includes(line), why: lines.includes(line) ? 'same rig, part and poses' : 'independent in each scan' }));
}

const resultOf = ({ scan, fit }: MockResult): Json => ({
  scan_id: scan['id'], fit_id: fit['id'], sample_id: scan['sample_id'], part: scan['sample_name'], region: null, variant: fit['variant'], operator_name: scan['operator_name'] ?? null, measured_at: scan['started_at'],
});
const valueOf = ({ value, std, expanded, coverage_factor }: MockParameter): Json => ({ value, std, expanded, coverage_factor });

export function comparison(a: MockResult, b: MockResult, stated: string | null): Json {
  const shared = sharedLines(stated);
  const rows = Object.entries(parameters(a)).map(([name, first]) => {
    const second = parameters(b)[name] ?? first;
    const lines = shared.map(({ line, shared: same }) => {
      const [u, v] = [first.budget?.[line] ?? 0, second.budget?.[line] ?? 0];
      return { line, shared: same, first_std: u, second_std: v, difference_std: same ? Math.abs(u - v) : Math.hypot(u, v) };
    }).filter((line) => line.first_std > 0 || line.second_std > 0);
    const std = hypot(lines.map((line) => line.difference_std));
    const known = first.value !== null && second.value !== null && std > 0;
    const value = (second.value ?? 0) - (first.value ?? 0);
    return { name, first: valueOf(first), second: valueOf(second), lines, difference: known ? { value, std, expanded: 2 * std, coverage_factor: 2, normalised: value / (2 * std), agrees: Math.abs(value) <= 2 * std } : null };
  });
  return { first: resultOf(a), second: resultOf(b), shared_lines: shared, parameters: rows, notes: a.scan['sample_id'] === b.scan['sample_id'] ? [] : ['The scans are of different parts.'] };
}

export function repeatability(all: readonly MockResult[], left: readonly number[], stated: string | null, by: string | null): Json {
  const shared = sharedLines(stated);
  const own = shared.filter((line) => !line.shared).map((line) => line.line);
  const angles = all.map((of) => parameters(of)['theta_r_deg'] as MockParameter);
  const mean = angles.reduce((sum, p) => sum + (p.value ?? 0), 0) / angles.length;
  const partOf = all.map((of) => of.scan['sample_id']);
  const parts = new Set(partOf).size;
  const meanOf = (part: unknown): number => {
    const own = angles.filter((_, i) => partOf[i] === part);
    return own.reduce((sum, p) => sum + (p.value ?? 0), 0) / own.length;
  };
  const deviations = angles.map((p, i) => (p.value ?? 0) - meanOf(partOf[i]));
  const s = Math.sqrt(deviations.reduce((sum, d) => sum + d ** 2, 0) / (angles.length - parts));
  const u = hypot(own.map((line) => angles[0]?.budget?.[line] ?? 0));
  const consistent = s < 2 * u;
  const spread = (std: number, share: number, note: string | null = null): Json => ({ std, degrees_of_freedom: 4, interval: note === null ? [0.6 * std, 2.9 * std] : null, percent_of_total: share, note });
  const gauge = {
    design: 'crossed', by: by ?? 'operator', n_parts: parts, n_groups: 2, balanced: true, interaction_probability: 0.4, interaction_pooled: true, rows: [],
    repeatability: spread(0.02, 18), reproducibility: spread(0.01, 9, '2 operators are too few for an interval: measure with at least 3'), gauge: spread(0.0224, 20), part_to_part: spread(0.11, 98), total: spread(0.112, 100),
    gauge_percent: { value: 20, interval: null, note: null }, distinct_categories: { value: 6, interval: [3, 18274], note: null }, notes: [],
  };
  return {
    parameter: 'theta_r_deg', shared_lines: shared, left_out: left.map((scan_id) => ({ scan_id, why: 'it has no completed fit' })),
    results: all.map((of, i) => ({ ...resultOf(of), ...valueOf(angles[i] as MockParameter), scattering_std: u, deviation: deviations[i], budget: angles[i]?.budget })),
    scatter: parts === all.length ? null : {
      n: all.length, n_parts: parts, mean: parts === 1 ? mean : null, std: s, std_interval: [0.5 * s, 6 * s], degrees_of_freedom: all.length - parts, stated_std: 0.043, stated_expanded: 0.086, scattering_std: u,
      ratio: u > 0 ? s / u : null, chi_square: (all.length - parts) * (s / u) ** 2, probability: consistent ? 0.6 : 1e-6, verdict: consistent ? 'consistent' : 'too-large',
      message: consistent ? 'The scatter is as large as the stated uncertainty.' : 'The scans scatter more than the stated uncertainty explains.',
    },
    gauge: parts > 1 ? gauge : null, gauge_note: parts > 1 ? null : 'one part, without groups: gauge R&R needs several parts',
  };
}
