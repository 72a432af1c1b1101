import { describe, expect, it } from 'vitest';

import { stageWords } from '../../src/lib/words';

describe('stageWords', () => {
  const waiting = { stage: 'waiting for its turn', fraction: 0, elapsed_s: 1, time_left_s: null };

  it('gives the stage of a job that runs', () => {
    expect(stageWords({ ...waiting, stage: 'fitting' })).toBe('fitting');
    expect(stageWords(undefined)).toBe('starting');
  });

  it('gives the place in the queue of a job that waits', () => {
    expect(stageWords({ ...waiting, queued_position: 1 })).toBe('waiting, next to start');
    expect(stageWords({ ...waiting, queued_position: 3 })).toBe('waiting, number 3 in the queue');
  });
});
