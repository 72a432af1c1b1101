import { describe, expect, it } from 'vitest';

import { decades, fallingLines, merged } from '../../src/lib/certainty';
import type { Certainty } from '../../src/lib/types';

const row = (id: number, elapsed_s: number, parameters: Certainty['parameters']): Certainty => ({
  id, elapsed_s, n_observations: id, n_frames_used: id, variant: 'sawtooth', status: 'converged', parameters,
});

describe('the fit that runs along', () => {
  it('has each row once, in the order of the rig’s time, whichever way it came', () => {
    const [a, b, c] = [row(3, 60, {}), row(7, 90, {}), row(9, 120, {})];
    expect(merged([b, a], [c, b]).map((r) => r.id)).toEqual([3, 7, 9]);
  });

  it('draws what any row knows, with gaps where the frames could not tell, on a scale that holds it', () => {
    const lines = fallingLines([row(1, 10, {}), row(2, 20, { theta_r_deg: { value: 10, std: 0.3 } }), row(3, 30, { theta_r_deg: { value: 10.1, std: 0.1 } })]);
    expect(lines).toHaveLength(1);
    expect(lines[0]?.std).toEqual([null, 0.3, 0.1]);
    expect(lines[0]?.now).toEqual({ value: 10.1, std: 0.1 });
    const [low, high] = decades(lines);
    expect(low).toBeLessThan(0.1);
    expect(high).toBeGreaterThan(0.3);
  });
});
