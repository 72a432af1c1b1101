import { describe, expect, it } from 'vitest';

import { brightestPose } from '../../src/lib/brightest';
import { posesOf } from '../../src/lib/plan';

const IN_PLANE = { theta_l_deg: 10, light_azimuth_deg: 0, azimuth_zero_deg: 0, light_angular_radius_deg: 1, lens_angular_radius_deg: null, wavelength_nm: 550 };
const grid = (tilts: readonly number[]) => posesOf({ theta_c_deg: tilts, phi_s_deg: [0, 90, 180, 270] });
const GRID = grid([-20, -15, -10, -5, 0, 5, 10, 15, 20]);

describe('the brightest pose of a plan', () => {
  it('has the facets half-way between camera and lamp', () => {
    // |θc + θl/2| = θr: at 5° with the lean towards +x, at −15° with the lean away from it; the smaller tilt is taken.
    expect(brightestPose(GRID, IN_PLANE, 10)).toEqual({ theta_c_deg: 5, phi_s_deg: 0 });
    expect(brightestPose(grid([-15, 0, 20]), IN_PLANE, 10)).toEqual({ theta_c_deg: -15, phi_s_deg: 180 });
    expect(brightestPose(GRID, { ...IN_PLANE, azimuth_zero_deg: 90 }, 10)).toEqual({ theta_c_deg: 5, phi_s_deg: 270 });
  });

  it('mirrors the lamp off a flat surface at half the lamp’s angle', () => {
    expect(brightestPose(GRID, IN_PLANE, 0)?.theta_c_deg).toBe(-5);
    // A lamp beside the tilt plane.
    expect(brightestPose(GRID, { ...IN_PLANE, light_azimuth_deg: 90 }, 0)?.theta_c_deg).toBe(0);
    expect(brightestPose([], IN_PLANE, 0)).toBeNull();
  });
});
