// Filters of the records, as the address keeps them.

import { isCalibration } from './calibrations';
import type { Scan } from './types';

export interface Filters {
  /** Words that must all appear in the sample's name, the number of the scan or who started it. */
  readonly search: string;
  readonly sample: string;
  readonly state: string;
  /** Days, YYYY-MM-DD in the time zone of the page; both included. */
  readonly from: string;
  readonly to: string;
}

export const NO_FILTERS: Filters = { search: '', sample: '', state: '', from: '', to: '' };

export function filtersOf(query: string): Filters {
  const params = new URLSearchParams(query);
  const day = (name: string): string => (/^\d{4}-\d{2}-\d{2}$/.test(params.get(name) ?? '') ? (params.get(name) ?? '') : '');
  return { search: params.get('search') ?? '', sample: params.get('sample') ?? '', state: params.get('state') ?? '', from: day('from'), to: day('to') };
}

/** The query of an address; empty without a filter. */
export function queryOf(filters: Filters): string {
  return new URLSearchParams(Object.entries(filters).filter(([, value]) => value !== '')).toString();
}

function dayOf(iso: string): string {
  const t = new Date(iso);
  const two = (n: number): string => String(n).padStart(2, '0');
  return `${t.getFullYear()}-${two(t.getMonth() + 1)}-${two(t.getDate())}`;
}

export function matches(scan: Scan, filters: Filters): boolean {
  const text = `${scan.id} ${isCalibration(scan) ? 'calibration' : scan.sample_name} ${scan.who ?? ''} ${scan.reason ?? ''}`.toLowerCase();
  if (!filters.search.toLowerCase().split(/\s+/).every((word) => text.includes(word))) return false;
  if (filters.sample !== '' && String(scan.sample_id) !== filters.sample) return false;
  if (filters.state !== '' && scan.state !== filters.state) return false;
  const day = dayOf(scan.started_at ?? scan.created_at);
  return (filters.from === '' || day >= filters.from) && (filters.to === '' || day <= filters.to);
}
