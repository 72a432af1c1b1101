// `GET /results` of the mock daemon: rows of scans with their newest fit, filtered, ordered and read page by page.

type Json = Record<string, unknown>;

interface Source {
  readonly scans: readonly { readonly body: Json & { readonly id: number; readonly sample_id: number; readonly state: string } }[];
  readonly fits: readonly Json[];
  /** Newest first. */
  readonly verdicts: readonly Json[];
}

/** A row of the results of each scan, newest first. What a test sets on a scan's `result` replaces a column. */
export function resultRows({ scans, fits, verdicts }: Source): Json[] {
  return scans.map(({ body }) => {
    const fit = fits.find((f) => f['scan_id'] === body.id && f['state'] === 'completed');
    const parameters = (fit?.['parameters'] ?? {}) as Record<string, { value: number | null; std: number | null; expanded: number | null }>;
    const verdict = verdicts.find((v) => v['scan_id'] === body.id);
    const items = (verdict?.['items'] ?? []) as readonly { quantity: string; value: number | null }[];
    const values = Object.entries(parameters).flatMap(([name, p]) => [[name, p.value], [`${name}_std`, p.std]] as const);
    return {
      scan_id: body.id, fit_id: fit?.['id'] ?? null, sample_id: body.sample_id, part: body['sample_name'], lot: body['lot'] ?? null, recipe: (body['recipe'] as Json | null | undefined)?.['name'] ?? null, recipe_version: null, external_id: body['external_id'] ?? null, operator_name: body['operator_name'] ?? null,
      material: 'dielectric', origin: body['origin'] ?? 'rig', state: body.state, status: fit?.['status'] ?? null, ...Object.fromEntries(values),
      theta_r_deg_expanded: parameters['theta_r_deg']?.expanded ?? null, coverage_factor: fit ? 2 : null, verdict: verdict?.['verdict'] ?? null, verdict_id: verdict?.['id'] ?? null, verdict_matches: verdict ? items.every((i) => parameters[i.quantity]?.value === i.value) : null, specification: verdict?.['specification'] ?? null,
      created_at: body['created_at'], ended_at: body['ended_at'], archived: body['archived'] ?? false, ...(body['result'] as Json | undefined),
    };
  });
}

function isWanted(row: Json, name: string, text: string): boolean {
  if (name === 'search') return ['part', 'lot', 'recipe', 'operator_name', 'external_id', 'specification'].some((column) => String(row[column] ?? '').toLowerCase().includes(text.toLowerCase()));
  if (name === 'since') return String(row['created_at']) >= new Date(text).toISOString();
  if (name === 'until') return String(row['created_at']) < new Date(text).toISOString();
  const [, column = '', end] = /^(.*)_(min|max)$/.exec(name) ?? [];
  if (end !== undefined) return row[column] != null && (end === 'min' ? Number(row[column]) >= Number(text) : Number(row[column]) <= Number(text));
  return text.split(',').includes(String(row[name] ?? ''));
}

function compared(a: unknown, b: unknown): number {
  return typeof a === 'number' && typeof b === 'number' ? a - b : String(a).localeCompare(String(b));
}

const OTHERS = ['sort', 'limit', 'cursor', 'count', 'fields', 'format', 'latest', 'archived'];

/** The answer to a query. */
export function resultsPage(all: readonly Json[], query: URLSearchParams): { items: Json[]; next_cursor: string | null; count: number } {
  let rows = all.filter((row) => [...query].every(([name, text]) => OTHERS.includes(name) || isWanted(row, name, text)));
  if (query.get('archived') !== 'all') rows = rows.filter((row) => row['archived'] !== true);
  if (query.get('latest') === 'true') rows = rows.filter((row) => row['fit_id'] !== null && !rows.some((other) => other['sample_id'] === row['sample_id'] && Number(other['scan_id']) > Number(row['scan_id'])));
  const sort = query.get('sort') ?? '-scan_id';
  const [column, sign] = sort.startsWith('-') ? [sort.slice(1), -1] : [sort, 1];
  rows.sort((a, b) => (a[column] == null ? 1 : b[column] == null ? -1 : sign * (compared(a[column], b[column]) || Number(a['scan_id']) - Number(b['scan_id']))));
  const begin = Number(query.get('cursor') ?? 0);
  const end = begin + Number(query.get('limit') ?? 100);
  const fields = query.get('fields')?.split(',');
  const items = rows.slice(begin, end).map((row) => (fields ? Object.fromEntries(fields.filter((f) => f in row).map((f) => [f, row[f]])) : row));
  return { items, next_cursor: end < rows.length ? String(end) : null, count: rows.length };
}
