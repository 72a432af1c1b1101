import { describe, expect, it } from 'vitest';

import { chartHash, parseRoute, resultHash } from '../../src/lib/route';

describe('an address', () => {
  it('names a view, a scan, a fit and a part, in either order and in its earlier form', () => {
    expect(parseRoute('')).toMatchObject({ view: 'measure', scans: [] });
    expect(parseRoute('#/nonsense')).toMatchObject({ view: 'measure' });
    expect(parseRoute('#/result/12')).toMatchObject({ view: 'result', scans: [12], fit: null, tab: null });
    expect(parseRoute('#/result/12/fit/3/frames')).toMatchObject({ scans: [12], fit: 3, tab: 'frames' });
    expect(parseRoute('#/result/frames')).toMatchObject({ view: 'result', scans: [], tab: 'frames' });
    expect(parseRoute('#/scan/12/fit/3')).toMatchObject({ view: 'result', scans: [12], fit: 3, tab: null });
    expect(parseRoute('#/repeat/3,5,x,9')).toMatchObject({ view: 'repeat', scans: [3, 5, 9] });
    expect(parseRoute('#/records?search=B-17%2F2')).toMatchObject({ view: 'records', query: 'search=B-17%2F2' });
  });

  it('is read back as it was written', () => {
    expect(parseRoute(resultHash(7, 2, 'map'))).toMatchObject({ view: 'result', scans: [7], fit: 2, tab: 'map' });
    expect(parseRoute(chartHash('recipe=PX&lot=7', 'alpha_u'))).toMatchObject({ view: 'chart', tab: 'alpha_u', query: 'recipe=PX&lot=7' });
    expect(parseRoute(chartHash(''))).toMatchObject({ view: 'chart', tab: null, query: '' });
    expect(parseRoute(resultHash(7, null, 'map'))).toMatchObject({ scans: [7], fit: null, tab: 'map' });
  });
});
