// The address of the page: which view it shows, and of what. Reloads, links and the back button keep both.

export type ViewName = 'measure' | 'result' | 'records' | 'compare' | 'repeat' | 'chart' | 'rig' | 'lab' | 'setup';

export interface Route {
  readonly view: ViewName;
  /** Scans of the view: one of a result, several of a comparison; none: the newest. */
  readonly scans: readonly number[];
  readonly fit: number | null;
  /** Part of a result; parameter of a control chart. */
  readonly tab: string | null;
  /** Filters of the records or of a control chart. */
  readonly query: string;
}

const VIEWS: readonly ViewName[] = ['measure', 'result', 'records', 'compare', 'repeat', 'chart', 'rig', 'lab', 'setup'];

const isView = (name: string): name is ViewName => (VIEWS as readonly string[]).includes(name);

/** Reads the part of an address from `#` on. An unknown one is the first view. */
export function parseRoute(hash: string): Route {
  const [path = '', query = ''] = hash.replace(/^#\/?/, '').split('?', 2);
  const [first = '', ...rest] = path.split('/');
  // Addresses of earlier versions: #/scan/12/fit/3.
  const view = first === 'scan' ? 'result' : isView(first) ? first : 'measure';
  const numbers = (rest[0] ?? '').split(',').filter((word) => /^\d{1,15}$/.test(word)).map(Number);
  const scans = ['result', 'compare', 'repeat'].includes(view) ? numbers : [];
  if (view === 'chart') return { view, scans, fit: null, tab: /^[a-z_]+$/.test(rest[0] ?? '') ? (rest[0] ?? null) : null, query };
  if (view !== 'result') return { view, scans, fit: null, tab: null, query };
  const [, fit] = /(?:^|\/)fit\/(\d{1,15})(?:\/|$)/.exec(path) ?? [];
  const tab = rest.slice(scans.length > 0 ? 1 : 0).find((word, i, all) => /^[a-z]+$/.test(word) && word !== 'fit' && all[i - 1] !== 'fit');
  return { view, scans: scans.slice(0, 1), fit: fit === undefined ? null : Number(fit), tab: tab ?? null, query };
}

/** The address of a result. */
export function resultHash(scan: number, fit: number | null = null, tab: string | null = null): string {
  return `#/result/${scan}${fit === null ? '' : `/fit/${fit}`}${tab === null ? '' : `/${tab}`}`;
}

/** The address of a control chart; `query` selects its scans. */
export function chartHash(query: string, parameter = 'theta_r_deg'): string {
  return `#/chart${parameter === 'theta_r_deg' ? '' : `/${parameter}`}${query === '' ? '' : `?${query}`}`;
}
