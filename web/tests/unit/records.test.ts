import { describe, expect, it } from 'vitest';

import { filtersOf, filterWords, NO_FILTERS, queryOf, resultsQuery, sortOf } from '../../src/lib/records';

describe('the filters of the records', () => {
  it('are parameters of the results: days in the time zone of the page, both included', () => {
    const asked = (some: object): Record<string, string> => Object.fromEntries(resultsQuery({ ...NO_FILTERS, ...some }));
    expect(asked({})).toEqual({});
    expect(asked({ search: ' B-17 ', sample: '3', lot: 'L7', recipe: 'PX', specification: 'drawing', state: 'aborted', latest: 'true' })).toEqual({ search: 'B-17', sample_id: '3', lot: 'L7', recipe: 'PX', specification: 'drawing', state: 'aborted', latest: 'true' });
    expect(asked({ verdict: 'fail,cannot-tell' })).toEqual({ verdict: 'fail,cannot-tell' });
    expect(asked({ verdict: 'none' })).toEqual({ verdict: '' });
    const day = asked({ from: '2026-02-28', to: '2026-02-28' });
    expect(new Date(day['since'] ?? '')).toEqual(new Date(2026, 1, 28));
    expect(new Date(day['until'] ?? '')).toEqual(new Date(2026, 2, 1));
  });

  it('leave out a number that is not complete', () => {
    expect([...resultsQuery({ ...NO_FILTERS, theta_min: '9,5', theta_max: '1e' })]).toEqual([['theta_r_deg_min', '9.5']]);
    expect([...resultsQuery({ ...NO_FILTERS, theta_min: '-' })]).toEqual([]);
  });

  it('and the order are kept in the address, without what is not valid', () => {
    const filters = { ...NO_FILTERS, search: 'B-17 & co', sample: '3', from: '2026-02-03', verdict: 'none', theta_max: '10.2' };
    expect(filtersOf(queryOf(filters, '-theta_r_deg'))).toEqual(filters);
    expect(sortOf(queryOf(filters, '-theta_r_deg'))).toBe('-theta_r_deg');
    expect(queryOf(NO_FILTERS)).toBe('');
    expect(filtersOf('from=yesterday&to=2026-13-40&verdict=good&sample=x&latest=1')).toEqual(NO_FILTERS);
    expect(sortOf('sort=a%20b')).toBe('-scan_id');
  });

  it('are said in words', () => {
    expect(filterWords(NO_FILTERS, undefined)).toBe('all scans');
    expect(filterWords({ ...NO_FILTERS, sample: '3', lot: '7', verdict: 'fail,cannot-tell' }, 'A-1')).toBe('part A-1, lot 7, verdict: does not pass');
    // A filter that is not in use is not named.
    expect(filterWords({ ...NO_FILTERS, theta_min: 'abc', theta_max: '10,2' }, undefined)).toBe('θr ≤ 10,2°');
    expect([...resultsQuery({ ...NO_FILTERS, tag: ' study-1 ', archived: 'all' })]).toEqual([['tags', 'study-1'], ['archived', 'all']]);
    expect(filtersOf('tag=study-1&archived=all')).toEqual({ ...NO_FILTERS, tag: 'study-1', archived: 'all' });
  });
});
