// The pose of a plan at which a surface reflects most of the lamp's light into the camera: there its facets halve the angle between
// the two. Frame as in `drawing.ts`.

import { cameraDirection, lampDirection, type Point3 } from './drawing';
import type { PlanPose } from './plan';
import type { Rig } from './types';

const RAD = Math.PI / 180;

/** Poses whose angles differ by less are equally good. */
const SAME_DEG = 1e-6;

/** The pose at which the facets of a ridge angle, which lean towards the azimuth of the sample, are nearest to the mirror direction;
 *  among equal ones that of the smallest tilt. A ridge angle of 0 is a flat surface. Null without poses. */
export function brightestPose(poses: readonly PlanPose[], geometry: Rig['geometry'], thetaRDeg: number): PlanPose | null {
  const sin = Math.sin(thetaRDeg * RAD);
  let best: { readonly pose: PlanPose; readonly off: number } | null = null;
  for (const pose of [...poses].sort((a, b) => Math.abs(a.theta_c_deg) - Math.abs(b.theta_c_deg))) {
    const camera = cameraDirection(pose.theta_c_deg);
    const lamp = lampDirection(pose.theta_c_deg, geometry.theta_l_deg, geometry.light_azimuth_deg);
    const lean = (pose.phi_s_deg + geometry.azimuth_zero_deg) * RAD;
    const off = between([sin * Math.cos(lean), sin * Math.sin(lean), Math.cos(thetaRDeg * RAD)], camera, lamp);
    if (best === null || off < best.off - SAME_DEG) best = { pose, off };
  }
  return best && best.pose;
}

/** Angle between a facet's normal and the middle of camera and lamp, degrees. */
function between(normal: Point3, camera: Point3, lamp: Point3): number {
  const half = camera.map((c, i) => c + (lamp[i] ?? 0));
  const along = half.reduce((sum, h, i) => sum + h * (normal[i] ?? 0), 0) / Math.hypot(...half);
  return Math.acos(Math.min(1, along)) / RAD;
}
