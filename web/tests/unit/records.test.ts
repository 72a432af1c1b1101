import { describe, expect, it } from 'vitest';

import { filtersOf, matches, NO_FILTERS, queryOf } from '../../src/lib/records';
import type { Scan } from '../../src/lib/types';

const scan = { id: 12, sample_id: 3, sample_name: 'Panel B-17', state: 'completed', who: 'anna', reason: null, started_at: new Date(2026, 1, 3, 14, 2).toISOString(), created_at: '', plan: { repeats: 1 } } as unknown as Scan;

describe('the filters of the records', () => {
  it('find a scan by its words, sample, state and day', () => {
    const found = (some: object): boolean => matches(scan, { ...NO_FILTERS, ...some });
    expect(found({})).toBe(true);
    expect(found({ search: 'b-17 anna' })).toBe(true);
    expect(found({ search: 'b-17 bert' })).toBe(false);
    expect(found({ sample: '3', state: 'completed' })).toBe(true);
    expect(found({ sample: '4' })).toBe(false);
    expect(found({ state: 'aborted' })).toBe(false);
    expect(found({ from: '2026-02-03', to: '2026-02-03' })).toBe(true);
    expect(found({ from: '2026-02-04' })).toBe(false);
    expect(found({ to: '2026-02-02' })).toBe(false);
  });

  it('are kept in the address, without invalid days', () => {
    const filters = { search: 'B-17 & co', sample: '3', state: '', from: '2026-02-03', to: '' };
    expect(filtersOf(queryOf(filters))).toEqual(filters);
    expect(queryOf(NO_FILTERS)).toBe('');
    expect(filtersOf('from=yesterday').from).toBe('');
  });
});
