// The pose of a plan at which a surface reflects most of the lamp's light into the camera: there its facets halve the angle between
// the two. Frame as in `drawing.ts`.

import { cameraDirection, lampDirection, type Point3 } from './drawing';
import type { Rig } from './types';

export interface PlannedPose {
  readonly theta_c_deg: number;
  readonly phi_s_deg: number;
}

const RAD = Math.PI / 180;

/** Poses whose angles differ by less are equally good. */
const SAME_DEG = 1e-6;

/** The pose at which the facets of a ridge angle, which lean towards the azimuth of the sample, are nearest to the mirror direction;
 *  among equal ones that of the smallest tilt. A ridge angle of 0 is a flat surface. Null without poses. */
export function brightestPose({ tilts, azimuths }: { readonly tilts: readonly number[]; readonly azimuths: readonly number[] }, geometry: Rig['geometry'], thetaRDeg: number): PlannedPose | null {
  let best: (PlannedPose & { readonly off: number }) | null = null;
  for (const theta_c_deg of [...tilts].sort((a, b) => Math.abs(a) - Math.abs(b))) {
    const [camera, lamp] = [cameraDirection(theta_c_deg), lampDirection(theta_c_deg, geometry.theta_l_deg, geometry.light_azimuth_deg)];
    for (const phi_s_deg of azimuths) {
      const lean = (phi_s_deg + geometry.azimuth_zero_deg) * RAD;
      const sin = Math.sin(thetaRDeg * RAD);
      const off = between([sin * Math.cos(lean), sin * Math.sin(lean), Math.cos(thetaRDeg * RAD)], camera, lamp);
      if (best === null || off < best.off - SAME_DEG) best = { theta_c_deg, phi_s_deg, off };
    }
  }
  return best && { theta_c_deg: best.theta_c_deg, phi_s_deg: best.phi_s_deg };
}

/** Angle between a facet's normal and the middle of camera and lamp, degrees. */
function between(normal: Point3, camera: Point3, lamp: Point3): number {
  const half = camera.map((c, i) => c + (lamp[i] ?? 0));
  const along = half.reduce((sum, h, i) => sum + h * (normal[i] ?? 0), 0) / Math.hypot(...half);
  return Math.acos(Math.min(1, along)) / RAD;
}
