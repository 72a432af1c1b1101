import { afterEach, beforeEach, expect, it, vi } from 'vitest';

import { api } from '../../src/lib/api';
import { hold } from '../../src/lib/jog';

beforeEach(() => void vi.useFakeTimers());
afterEach(() => {
  vi.useRealTimers();
  vi.restoreAllMocks();
});

const answer = { jog: 7, ended: false, at_end: null };

it('a jog is renewed well within half a second and ended once', async () => {
  const asked = vi.spyOn(api, 'jog').mockResolvedValue(answer);
  const ends: (string | null)[] = [];
  const jog = hold('phi_s', -2, (why) => ends.push(why));
  await vi.advanceTimersByTimeAsync(1000);
  const renewals = asked.mock.calls.length - 1;
  expect(renewals).toBeGreaterThanOrEqual(5);
  asked.mockResolvedValueOnce({ ...answer, at_end: 'phi_s is at its limit' });
  await vi.advanceTimersByTimeAsync(160);
  expect(ends).toContain('phi_s is at its limit');
  jog.release();
  await jog.done;
  const calls = asked.mock.calls.map(([body]) => body);
  expect(calls[0]).toEqual({ axis: 'phi_s', speed_deg_s: -2 });
  expect(calls.slice(1, -1).every((body) => body.jog === 7 && body.speed_deg_s === -2)).toBe(true);
  expect(calls.at(-1)).toEqual({ axis: 'phi_s', speed_deg_s: 0, jog: 7 });
  const all = asked.mock.calls.length;
  await vi.advanceTimersByTimeAsync(1000);
  expect(asked.mock.calls.length).toBe(all);
});

it('a button released before the answer ends the jog at once, and a refusal is passed on', async () => {
  const asked = vi.spyOn(api, 'jog').mockResolvedValue(answer);
  const short = hold('theta_c', 1, () => undefined);
  short.release();
  await short.done;
  expect(asked.mock.calls.map(([body]) => body.speed_deg_s)).toEqual([1, 0]);
  asked.mockRejectedValueOnce(new Error('busy'));
  await expect(hold('theta_c', 1, () => undefined).done).rejects.toThrow('busy');
});
