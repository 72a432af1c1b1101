import { describe, expect, it } from 'vitest';

import type { Fit, Parameter, Sample, Scan } from '../../src/lib/types';
import { varianceShares } from '../../src/lib/budgetwords';
import { identifiability, knownOf, sampleFrames, warningWords } from '../../src/lib/words';

describe('varianceShares', () => {
  it('adds up to one, in quadrature, in the legend’s order', () => {
    const shares = varianceShares({ model: 0.4, counting: 0.3, zero: 0 });
    expect(shares.map((s) => s.key)).toEqual(['counting', 'model']);
    expect(shares[0]?.share).toBeCloseTo(0.36, 12);
    expect(shares[1]?.share).toBeCloseTo(0.64, 12);
  });

  it('omits rounding errors', () => {
    expect(varianceShares({ angles: 8e-17, model: 0.01 }).map((s) => s.key)).toEqual(['model']);
  });

  it('puts unknown sources last', () => {
    expect(varianceShares({ novel: 1, model: 1, counting: 1 }).map((s) => s.key)).toEqual(['counting', 'model', 'novel']);
  });
});

describe('identifiability', () => {
  const parameter: Parameter = { value: 1, std: 0.1, expanded: 0.2, coverage_factor: 2, identifiable: true, budget: {} };

  it('never calls a null determined', () => {
    expect(identifiability({ ...parameter, value: null }).tone).toBe('bad');
    expect(identifiability({ ...parameter, identifiable: false, note: 'no white reference' })).toEqual({
      word: 'not determined by these data', tone: 'bad', detail: 'no white reference',
    });
    expect(identifiability(parameter).tone).toBe('good');
    expect(identifiability({ ...parameter, std: null, expanded: null, identifiable: false }, { held: true }).word).toBe('fixed');
    expect(identifiability({ ...parameter, note: 'fixed by the white reference' })).toEqual({ word: 'fixed', tone: 'plain', detail: 'fixed by the white reference' });
    expect(identifiability({ ...parameter, value: null, identifiable: false }, { metal: true }).word).toBe('not applicable (metal)');
  });

  it('knows what the request held, and that a metal has no diffuse reflectance', () => {
    const fit = { sample_id: 2, request: { fix: { theta_r_deg: 10 } } } as unknown as Fit;
    const samples = [{ id: 2, material: { kind: 'conductor' } }] as unknown as Sample[];
    expect(knownOf('theta_r_deg', fit, samples)).toEqual({ held: true, metal: false });
    expect(knownOf('rho_d', fit, samples)).toEqual({ held: false, metal: true });
    expect(knownOf('rho_d', fit, [])).toEqual({ held: false, metal: false });
  });
});

describe('warningWords', () => {
  it('distinguishes faults from warnings', () => {
    expect(warningWords('FS: stalled; look what is in the way')).toEqual({ code: 'FS', text: 'stalled; look what is in the way', serious: true });
    expect(warningWords('WR: no reference position; home the axis')).toEqual({ code: 'WR', text: 'no reference position; home the axis', serious: false });
    expect(warningWords('XY')).toEqual({ code: 'XY', text: '', serious: false });
    expect(warningWords('the cable is loose')).toEqual({ code: '', text: 'the cable is loose', serious: false });
  });
});

describe('sampleFrames', () => {
  const scan = (progress: Partial<Scan['progress']>): Scan =>
    ({ origin: 'rig', plan: { theta_c_deg: [0, 1], phi_s_deg: [0, 90], poses: [], exposures_s: [0.02], repeats: 2 }, progress: { phase: 'flat', frames_done: 0, frames_total: 12, ...progress } }) as unknown as Scan;
  it('counts no calibration frames', () => {
    expect([0, 4, 5, 12].map((frames_done) => sampleFrames(scan({ frames_done })))).toEqual([0, 0, 1, 8]);
  });
  it('counts none before the scan begins, when no total is known', () => {
    expect(sampleFrames(scan({ phase: null, frames_total: 0 }))).toBe(0);
  });
});
