import { describe, expect, it } from 'vitest';

import { sentence } from '../../src/lib/api';
import { refusedWords } from '../../src/lib/fitoptions';
import { pageWords, resultWords } from '../../src/lib/pagewords';

describe('the page’s own words', () => {
  it('stand for flags, keys and ticks of the command line', () => {
    expect(sentence('others may differ from it by more: `--surfaces N` shows by how much')).toBe('Others may differ from it by more: “Surfaces, drawn anew” shows by how much.');
    expect(pageWords('The budget line `model` contains the model error.')).toBe('The budget line “model” contains the model error.');
    expect(pageWords('Set rig.azimuth_zero_std_deg to separate them.')).toBe('Set it in the rig’s settings (azimuth_zero_std_deg) to separate them.');
    expect(pageWords('uncertainty of theta_l')).toBe('uncertainty of the angle between lamp and camera');
    expect(sentence('theta_c has no reference position: home it first')).toBe('The camera tilt has no reference position: home it first.');
    expect(pageWords('a wedge cannot show; state rig.sample_wedge_std_deg, or remount')).toBe('a wedge cannot show; state it in the rig’s settings (sample_wedge_std_deg), or remount');
  });

  it('leave alone what a scene’s keys are called, and name parameters in results', () => {
    expect(pageWords('interface 1: alpha_u lies from 0 to 10')).toBe('interface 1: alpha_u lies from 0 to 10');
    expect(resultWords('These data cannot separate tilt_offset_deg, theta_r_deg.')).toBe('These data cannot separate tilt offset, ridge angle.');
    expect(refusedWords(sentence('fix.theta_r_deg: theta_r_deg is out of range; give a value from 0 to 89'))).toBe('The ridge angle is out of range; give a value from 0 to 89.');
  });
});
