import { describe, expect, it } from 'vitest';

import { problemSentence, sentence } from '../../src/lib/api';
import type { Parameter, Scan } from '../../src/lib/types';
import { identifiability, planWords, sampleFrames, varianceShares, warningWords } from '../../src/lib/words';

describe('problemSentence', () => {
  it('says the detail and every field’s fault, once each', () => {
    const body = {
      title: 'the plan cannot run',
      detail: 'two angles are beyond the travel',
      errors: [
        { field: 'plan.theta_c_deg[2]', message: '75° is beyond the limit of 60°' },
        { field: 'plan.theta_c_deg[2]', message: '75° is beyond the limit of 60°' },
      ],
    };
    expect(problemSentence(body, 'x')).toBe('Two angles are beyond the travel. 75° is beyond the limit of 60°.');
  });

  it('falls back where the body is no problem', () => {
    expect(problemSentence(null, 'the daemon answered 502')).toBe('The daemon answered 502.');
    expect(problemSentence({ title: 'busy' }, 'x')).toBe('Busy.');
    expect(sentence('Is it on?')).toBe('Is it on?');
  });
});

describe('varianceShares', () => {
  it('adds up to one, in quadrature, in the legend’s order', () => {
    const shares = varianceShares({ model: 0.4, counting: 0.3, zero: 0 });
    expect(shares.map((s) => s.key)).toEqual(['counting', 'model']);
    expect(shares[0]?.share).toBeCloseTo(0.36, 12);
    expect(shares[1]?.share).toBeCloseTo(0.64, 12);
  });

  it('leaves out what is only rounding', () => {
    expect(varianceShares({ angles: 8e-17, model: 0.01 }).map((s) => s.key)).toEqual(['model']);
  });

  it('puts sources without a word of their own last', () => {
    expect(varianceShares({ novel: 1, model: 1, counting: 1 }).map((s) => s.key)).toEqual(['counting', 'model', 'novel']);
  });
});

describe('identifiability', () => {
  const told: Parameter = { value: 1, std: 0.1, expanded: 0.2, coverage_factor: 2, identifiable: true, budget: {} };

  it('never calls a null determined', () => {
    expect(identifiability({ ...told, value: null }).tone).toBe('bad');
    expect(identifiability({ ...told, identifiable: false, note: 'no white reference' })).toEqual({
      word: 'not determined by these data', tone: 'bad', detail: 'no white reference',
    });
    expect(identifiability(told).tone).toBe('good');
    expect(identifiability({ ...told, std: null, expanded: null, identifiable: false, note: 'held at the stated value' }).word).toBe('held fixed');
    expect(identifiability({ ...told, note: 'fixed by the white reference' })).toEqual({ word: 'held fixed', tone: 'plain', detail: 'fixed by the white reference' });
  });
});

describe('warningWords', () => {
  it('tells faults from warnings', () => {
    expect(warningWords('FS: stalled; look what is in the way')).toEqual({ code: 'FS', text: 'stalled; look what is in the way', serious: true });
    expect(warningWords('WR: no reference position; home the axis')).toEqual({ code: 'WR', text: 'no reference position; home the axis', serious: false });
    expect(warningWords('XY')).toEqual({ code: 'XY', text: '', serious: false });
    expect(warningWords('the cable is loose')).toEqual({ code: '', text: 'the cable is loose', serious: false });
  });
});

describe('planWords', () => {
  it('says a plan’s faults as the form calls them, exposures in ms', () => {
    const said = 'The plan cannot run: plan.theta_c_deg[0]: -90° is outside the travel of the camera tilt, -60.000° to 60.000°; plan.exposures_s[0]: -0.004 s is not between 0.000001 and 3600 s.';
    expect(planWords(said)).toBe('Camera tilt: −90° is outside the travel of the camera tilt, −60° to 60°. Exposure: −4 ms is not between 0.001 and 3600000 ms.');
    const many = 'The plan cannot run: plan.theta_c_deg[0]: -90° is outside the travel, -60° to 60°; plan.theta_c_deg[1]: -80° is outside the travel, -60° to 60°.';
    expect(planWords(many)).toBe('Camera tilt: −90°, −80° is outside the travel, −60° to 60°.');
    expect(planWords('The disk is full.')).toBe('The disk is full.');
  });
});

describe('sampleFrames', () => {
  const scan = (progress: Partial<Scan['progress']>): Scan =>
    ({ origin: 'rig', plan: { theta_c_deg: [0, 1], phi_s_deg: [0, 90], exposures_s: [0.02], repeats: 2 }, progress: { phase: 'flat', frames_done: 0, frames_total: 12, ...progress } }) as unknown as Scan;
  it('counts none while the calibration is taken, and then all beyond it', () => {
    expect([0, 4, 5, 12].map((frames_done) => sampleFrames(scan({ frames_done })))).toEqual([0, 0, 1, 8]);
  });
});
