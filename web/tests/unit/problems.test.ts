import { describe, expect, it } from 'vitest';

import { faultWords, problemOf, sentence, spoken } from '../../src/lib/problems';

describe('problemOf', () => {
  it('shows the detail of a problem without fields, and keeps its code', () => {
    const problem = problemOf(409, { code: 'busy', title: 'the rig is busy', detail: 'the rig is busy: an axis is moving' }, 'x');
    expect([problem.status, problem.code, problem.message]).toEqual([409, 'busy', 'The rig is busy: an axis is moving.']);
    expect(spoken(problem)).toBe(problem.message);
  });

  it('names the fields as the form does, each message once', () => {
    const field = { field: 'plan.repeats', message: 'must be at least 1' };
    const problem = problemOf(422, { code: 'plan-invalid', title: 'the plan cannot run', detail: 'plan.repeats: must be at least 1', errors: [field, field] }, 'x');
    expect(problem.message).toBe('Repeats: must be at least 1.');
    expect(problem.errors).toHaveLength(2);
  });

  it('says what to do on the page where a code needs it', () => {
    const problem = problemOf(422, { code: 'frame-unreadable', detail: 'frames/7.png is torn' }, 'x');
    expect(problem.message).toBe('Frames/7.png is torn. To import the other frames, tick “leave out frames that cannot be read”.');
  });

  it('falls back where the body is not a problem', () => {
    expect(problemOf(502, null, 'the daemon answered 502').message).toBe('The daemon answered 502.');
    expect(problemOf(502, null, 'x').code).toBe('http-502');
    expect(problemOf(409, { title: 'busy' }, 'x').message).toBe('Busy.');
    expect(sentence('Is it on?')).toBe('Is it on?');
  });
});

describe('faultWords', () => {
  it('puts values with the same range into one sentence, exposures in ms', () => {
    const tilt = (i: number, value: number) => ({ field: `plan.theta_c_deg[${i}]`, message: `${value}° is outside the travel`, out_of_range: { value, lower: -60, upper: 60 } });
    const exposure = { field: 'plan.exposures_s[0]', message: '-0.004 s is outside', out_of_range: { value: -0.004, lower: 1e-6, upper: 3600 } };
    expect(faultWords([tilt(0, -90), exposure, tilt(1, -80)])).toBe(
      'Camera tilt: −90°, −80° are outside −60 to 60°. Exposure: −4 ms is outside 0.001 to 3600000 ms.',
    );
  });

  it('calls a parameter by its name, and a field without a name by its path', () => {
    expect(faultWords([{ field: 'fix.rho_d', message: 'lies between 0 and 1' }])).toBe('Diffuse reflectance: lies between 0 and 1.');
    expect(faultWords([{ field: 'new.thing', message: 'is missing' }])).toBe('New.thing: is missing.');
  });
});
