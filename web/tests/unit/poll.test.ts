import { afterEach, beforeEach, describe, expect, it, vi } from 'vitest';

import { whileRunning } from '../../src/lib/poll';

type Row = { readonly state: string };
const none = (): void => undefined;

beforeEach(() => void vi.useFakeTimers());
afterEach(() => void vi.useRealTimers());

describe('running work', () => {
  it('is polled until it has ended', async () => {
    const answers: Row[][] = [[{ state: 'running' }, { state: 'completed' }], [{ state: 'running' }], [{ state: 'failed' }]];
    const left = [...answers];
    const ask = vi.fn(async () => left.shift() ?? []);
    const taken: (readonly Row[])[] = [];
    whileRunning(ask, (rows) => taken.push(rows), none);
    await vi.runAllTimersAsync();
    expect(taken).toEqual(answers);
    expect(ask).toHaveBeenCalledTimes(3);
  });

  it('is not polled after the end, and a pending answer is not passed on', async () => {
    const ask = vi.fn(async (_: AbortSignal): Promise<Row[]> => [{ state: 'running' }]);
    const take = vi.fn();
    const end = whileRunning(ask, take, none);
    await vi.advanceTimersByTimeAsync(0);
    expect(take).toHaveBeenCalledTimes(1);
    await vi.advanceTimersToNextTimerAsync();
    end();
    const asked = ask.mock.calls.length;
    await vi.runAllTimersAsync();
    expect(ask).toHaveBeenCalledTimes(asked);

    let answer: (rows: Row[]) => void = () => undefined;
    const late = vi.fn();
    const endLate = whileRunning(() => new Promise<Row[]>((resolve) => (answer = resolve)), late, none);
    endLate();
    answer([{ state: 'running' }]);
    await vi.runAllTimersAsync();
    expect(late).not.toHaveBeenCalled();
    expect(ask.mock.calls[0]?.[0].aborted).toBe(true);
  });

  it('is not polled after a failed request', async () => {
    const ask = vi.fn(async (): Promise<Row[]> => Promise.reject(new Error('no answer')));
    const [take, failed] = [vi.fn(), vi.fn()];
    whileRunning(ask, take, failed);
    await vi.runAllTimersAsync();
    expect(ask).toHaveBeenCalledTimes(1);
    expect(take).not.toHaveBeenCalled();
    expect(failed.mock.calls).toEqual([[new Error('no answer')]]);
  });
});
