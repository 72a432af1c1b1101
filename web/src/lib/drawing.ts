// The drawing of the rig: directions of camera and lamp for a pose, and their places in an orthographic projection.
// The frame is that of the program's module `geometry`: x to the right, z up (the normal of the turntable), y away from the viewer.

export type Point3 = readonly [number, number, number];

const RAD = Math.PI / 180;

/** Direction of the camera at a tilt: in the xz-plane, positive towards +x. */
export function cameraDirection(thetaCDeg: number): Point3 {
  return [Math.sin(thetaCDeg * RAD), 0, Math.cos(thetaCDeg * RAD)];
}

/** Direction of the lamp, which is fixed to the camera: θl away from it, at azimuth φl about its axis (0: in the tilt plane). */
export function lampDirection(thetaCDeg: number, thetaLDeg: number, lightAzimuthDeg: number): Point3 {
  const [sinC, cosC] = [Math.sin(thetaCDeg * RAD), Math.cos(thetaCDeg * RAD)];
  const [sinL, cosL] = [Math.sin(thetaLDeg * RAD), Math.cos(thetaLDeg * RAD)];
  const [sinA, cosA] = [Math.sin(lightAzimuthDeg * RAD), Math.cos(lightAzimuthDeg * RAD)];
  return [cosL * sinC + sinL * cosA * cosC, sinL * sinA, cosL * cosC - sinL * cosA * sinC];
}

/** Angle of a direction from the normal, degrees. */
export const fromNormalDeg = (direction: Point3): number => Math.acos(Math.min(1, Math.max(-1, direction[2]))) / RAD;

/** A point of the turntable at this azimuth, counter-clockwise seen from above. */
export const onTable = (azimuthDeg: number, radius: number): Point3 => [radius * Math.cos(azimuthDeg * RAD), radius * Math.sin(azimuthDeg * RAD), 0];

/** The viewer stands a little to the right of the tilt plane's normal and above the turntable. */
const [VIEWER_RAD, ABOVE_RAD] = [14 * RAD, 20 * RAD];

/** Orthographic projection to the page, y downwards; `unit` is the length of 1 in units of the drawing. */
export function projected([x, y, z]: Point3, unit: number): readonly [number, number] {
  const far = y * Math.cos(VIEWER_RAD) - x * Math.sin(VIEWER_RAD);
  return [unit * (x * Math.cos(VIEWER_RAD) + y * Math.sin(VIEWER_RAD)), unit * (-z * Math.cos(ABOVE_RAD) - far * Math.sin(ABOVE_RAD))];
}

/** An SVG path through points. */
export function path(points: readonly Point3[], unit: number, closed = false): string {
  const places = points.map((p) => projected(p, unit).map((c) => c.toFixed(1)).join(' '));
  return `M${places.join('L')}${closed ? 'Z' : ''}`;
}

/** Points of an arc, every two degrees and at both ends. */
export function arc(fromDeg: number, toDeg: number, at: (deg: number) => Point3): Point3[] {
  const n = Math.max(1, Math.ceil(Math.abs(toDeg - fromDeg) / 2));
  return Array.from({ length: n + 1 }, (_, i) => at(fromDeg + ((toDeg - fromDeg) * i) / n));
}
