import { describe, expect, it } from 'vitest';

import { faultWords, problemOf, sentence, spoken, withSymbols } from '../../src/lib/problems';

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
    expect(problem.message).toBe('frames/7.png is torn. To import the other frames, tick “leave out frames that cannot be read”.');
  });

  it('names the holder of the rig in words of the page', () => {
    const holder = { who: 'local', name: 'page of local', until: new Date(2026, 0, 2, 15, 3).toISOString() };
    const { message } = problemOf(409, { code: 'lease-held', detail: 'local holds the rig (`take_over` of POST /api/v1/lease)', holder }, 'x');
    expect(message).toBe('local holds the rig: page of local, until 2026-01-02 15:03 or longer. Wait, or take the rig over in the view Rig.');
    expect(problemOf(409, { code: 'lease-lost', detail: 'take a new one (POST /api/v1/lease)' }, 'x').message).not.toContain('POST');
  });

  it('falls back where the body is not a problem', () => {
    expect(problemOf(502, null, 'the daemon answered 502').message).toBe('The daemon answered 502.');
    expect(problemOf(502, null, 'x').code).toBe('http-502');
    expect(problemOf(409, { title: 'busy' }, 'x').message).toBe('Busy.');
    expect(sentence('Is it on?')).toBe('Is it on?');
  });
});

describe('sentence', () => {
  it('begins with a capital letter, unless the first word is a file, a path, a key or a symbol', () => {
    expect(sentence('well-known words')).toBe('Well-known words.');
    expect(sentence('manifest.toml line 9: no such key')).toBe('manifest.toml line 9: no such key.');
    expect(sentence('frames/sample_tc0.png has other pixels')).toBe('frames/sample_tc0.png has other pixels.');
    expect(sentence('θr is outside its limits')).toBe('θr is outside its limits.');
    expect(sentence('alpha_u is at its bound')).toBe('alpha_u is at its bound.');
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

  it('calls the target of a move as its form does', () => {
    const beyond = (field: string) => faultWords([{ field, message: 'theta_c = 500.000° is outside its limits', out_of_range: { value: 500, lower: -60, upper: 60 } }]);
    expect(beyond('position_deg')).toBe('Position: 500° is outside −60 to 60°.');
    expect(beyond('theta_c_deg')).toBe('Camera tilt: 500° is outside −60 to 60°.');
  });

  it('calls a parameter by its name, and a field without a name by its path', () => {
    expect(faultWords([{ field: 'fix.rho_d', message: 'lies between 0 and 1' }])).toBe('Diffuse reflectance: lies between 0 and 1.');
    expect(faultWords([{ field: 'new.thing', message: 'is missing' }])).toBe('new.thing: is missing.');
  });
});

describe('names of the axes', () => {
  it('are the symbols of the page in a message, and stay as they are in paths and longer names', () => {
    expect(withSymbols('theta_c stalled at 12.3°; home phi_s.')).toBe('θc stalled at 12.3°; home φs.');
    for (const text of ['plan.theta_c_deg[1]', 'axes.theta_c.limit', '/rig/axes/phi_s/home', 'theta_c.limit_min_deg']) expect(withSymbols(text)).toBe(text);
  });
});
