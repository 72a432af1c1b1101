import { describe, expect, it } from 'vitest';

import { cameraDirection, fromNormalDeg, lampDirection, onTable, projected } from '../../src/lib/drawing';

describe('the drawing of the rig', () => {
  it('has the lamp at the given angle from the camera, wherever it is about its axis', () => {
    for (const [tilt, azimuth] of [[0, 0], [-20, 0], [35, 90], [50, 213]] as const) {
      const [camera, lamp] = [cameraDirection(tilt), lampDirection(tilt, 10, azimuth)];
      const cosine = camera[0] * lamp[0] + camera[1] * lamp[1] + camera[2] * lamp[2];
      expect((Math.acos(cosine) * 180) / Math.PI).toBeCloseTo(10, 9);
    }
    // In the tilt plane the angles add.
    expect(fromNormalDeg(lampDirection(20, 10, 0))).toBeCloseTo(30, 9);
    expect(fromNormalDeg(lampDirection(-20, 10, 0))).toBeCloseTo(10, 9);
  });

  it('shows a positive tilt to the right and a positive azimuth counter-clockwise', () => {
    expect(projected(cameraDirection(30), 1)[0]).toBeGreaterThan(0);
    const [zero, quarter] = [projected(onTable(0, 1), 1), projected(onTable(90, 1), 1)];
    expect(zero[0] * quarter[1] - zero[1] * quarter[0]).toBeLessThan(0);
  });
});
