// Filters of the records and of the control chart: as the address of the page keeps them, and as `GET /results` takes them.

import { typed } from './typed';

export interface Filters {
  /** Part of the name of part, lot, recipe, operator or specification, or of the external id. */
  readonly search: string;
  /** Number of the part. */
  readonly sample: string;
  readonly lot: string;
  /** A tag of the scan. */
  readonly tag: string;
  readonly recipe: string;
  readonly specification: string;
  /** Words of the verdict, separated by commas; `none` for scans that were not judged. */
  readonly verdict: string;
  readonly state: string;
  /** Days, YYYY-MM-DD in the time zone of the page; both included. */
  readonly from: string;
  readonly to: string;
  /** Range of θr in degrees, as typed. */
  readonly theta_min: string;
  readonly theta_max: string;
  /** `true`: only the newest fitted scan of each part. */
  readonly latest: string;
  /** `all`: archived scans too. */
  readonly archived: string;
}

export const NO_FILTERS: Filters = { search: '', sample: '', lot: '', tag: '', recipe: '', specification: '', verdict: '', state: '', from: '', to: '', theta_min: '', theta_max: '', latest: '', archived: '' };

/** Order of the rows if the address names none: the newest scan first. */
const NEWEST_FIRST = '-scan_id';

/** Columns of a row of the list; without the others it is shorter. */
export const ROW_FIELDS = 'scan_id,region,fit_id,part,lot,recipe,recipe_version,external_id,operator_name,origin,state,status,theta_r_deg,theta_r_deg_expanded,coverage_factor,verdict,verdict_matches,specification,created_at,tags,archived';

export const VERDICT_CHOICES: readonly (readonly [string, string])[] = [
  ['', 'any or none'],
  ['pass', 'pass'],
  ['fail', 'fail'],
  ['cannot-tell', 'cannot tell'],
  ['fail,cannot-tell', 'does not pass'],
  ['none', 'not judged'],
];

const isDay = (text: string): boolean => /^\d{4}-\d{2}-\d{2}$/.test(text) && !Number.isNaN(Date.parse(text));

/** The filters of an address; what is not valid is left out. */
export function filtersOf(query: string): Filters {
  const params = new URLSearchParams(query);
  const read = (name: keyof Filters, valid: (text: string) => boolean = () => true): string => {
    const text = params.get(name) ?? '';
    return valid(text) ? text : '';
  };
  const plainText = ['search', 'lot', 'tag', 'recipe', 'specification', 'state', 'theta_min', 'theta_max'] as const;
  return {
    ...NO_FILTERS,
    ...Object.fromEntries(plainText.map((name) => [name, read(name)])),
    sample: read('sample', (text) => /^\d{1,15}$/.test(text)),
    verdict: read('verdict', (text) => VERDICT_CHOICES.some(([value]) => value === text)),
    from: read('from', isDay),
    to: read('to', isDay),
    latest: read('latest', (text) => text === 'true'),
    archived: read('archived', (text) => text === 'all'),
  };
}

/** The order that an address asks for. */
export function sortOf(query: string): string {
  const text = new URLSearchParams(query).get('sort') ?? '';
  return /^-?[a-z_]+$/.test(text) ? text : NEWEST_FIRST;
}

/** The query of an address; empty without a filter. */
export function queryOf(filters: Filters, sort = NEWEST_FIRST): string {
  const entries = Object.entries(filters).filter(([, value]) => value !== '');
  if (sort !== NEWEST_FIRST) entries.push(['sort', sort]);
  return new URLSearchParams(entries).toString();
}

/** Midnight of the page's time zone at the start of a day, or of the day after it, in UTC. */
function midnight(day: string, after = 0): string {
  const [year = 0, month = 1, date = 1] = day.split('-').map(Number);
  return new Date(year, month - 1, date + after).toISOString().replace('.000Z', 'Z');
}

/** Whether a typed number is not one. */
export const isUnclear = (text: string): boolean => !Number.isFinite(typed(text) ?? 0);

/** The filters as parameters of `GET /results`. A number that is being typed does not count yet. */
export function resultsQuery(filters: Filters): URLSearchParams {
  const params = new URLSearchParams();
  const set = (name: string, value: string): void => void (value !== '' && params.set(name, value));
  set('search', filters.search.trim());
  set('sample_id', filters.sample);
  set('lot', filters.lot.trim());
  set('tags', filters.tag.trim());
  set('recipe', filters.recipe.trim());
  set('specification', filters.specification.trim());
  if (filters.verdict === 'none') params.set('verdict', '');
  else set('verdict', filters.verdict);
  set('state', filters.state);
  set('since', filters.from === '' ? '' : midnight(filters.from));
  set('until', filters.to === '' ? '' : midnight(filters.to, 1));
  for (const [name, text] of [['theta_r_deg_min', filters.theta_min], ['theta_r_deg_max', filters.theta_max]] as const) {
    const value = typed(text);
    if (value !== null && !isUnclear(text)) params.set(name, String(value));
  }
  set('latest', filters.latest);
  set('archived', filters.archived);
  return params;
}

/** The filters in words: `part A-1, lot 7`; `all scans` without one. */
export function filterWords(filters: Filters, sampleName: string | undefined): string {
  const verdict = VERDICT_CHOICES.find(([value]) => value === filters.verdict)?.[1] ?? filters.verdict;
  const words = [
    filters.sample && `part ${sampleName ?? `no. ${filters.sample}`}`,
    filters.recipe && `recipe ${filters.recipe}`,
    filters.specification && `specification ${filters.specification}`,
    filters.lot && `lot ${filters.lot}`,
    filters.tag && `tag ${filters.tag}`,
    filters.search && `“${filters.search}”`,
    filters.verdict && `verdict: ${verdict}`,
    filters.state && `state: ${filters.state}`,
    filters.from && `from ${filters.from}`,
    filters.to && `to ${filters.to}`,
    !isUnclear(filters.theta_min) && filters.theta_min && `θr ≥ ${filters.theta_min}°`,
    !isUnclear(filters.theta_max) && filters.theta_max && `θr ≤ ${filters.theta_max}°`,
    filters.latest && 'newest scan of each part',
    filters.archived && 'archived scans too',
  ].filter((word) => word !== '' && word !== false);
  return words.length === 0 ? 'all scans' : words.join(', ');
}
