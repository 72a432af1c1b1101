import { describe, expect, it } from 'vitest';

import { exposureWarning, fullExposure } from '../../src/lib/preview.svelte';

const frame = (exposure_s: number, max_dn: number, saturated_px = 0): { exposure_s: number; max_dn: number; saturated_px: number } => ({ exposure_s, max_dn, saturated_px });

describe('the exposure of a full pixel', () => {
  it('is that of the suggestion, or else of the longest bright frame that is not full', () => {
    expect(fullExposure({ frames: [], suggestion: { exposures_s: [0.035, 0.1], reason: null } }, 65535)).toBeCloseTo(0.05);
    expect(fullExposure({ frames: [frame(0.02, 20000), frame(0.04, 40000), frame(1, 65535, 12)], suggestion: null }, 65535)).toBeCloseTo(0.0655, 3);
  });

  it('is unknown where all frames are dark or full', () => {
    expect(fullExposure({ frames: [frame(0.02, 240), frame(5, 65535, 900)], suggestion: null }, 65535)).toBeNull();
    expect(fullExposure({ frames: [], suggestion: { exposures_s: [10], reason: 'there is too little light' } }, 65535)).toBeNull();
  });
});

describe('a warning about exposures', () => {
  it('names what is too long and what is too short, and nothing else', () => {
    expect(exposureWarning([20], 0.08)).toContain('20 s is too long');
    expect(exposureWarning([0.00002], 0.08)).toContain('0.02 ms uses less than 3 %');
    expect(exposureWarning([0.02, 0.2], 0.08)).toBeNull();
    expect(exposureWarning([20], null)).toBeNull();
    expect(exposureWarning([], 0.08)).toBeNull();
  });
});
