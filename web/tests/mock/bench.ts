// Minimal optics of the mock daemon, so that pictures and curves look like those of a ridged
// sample. Not a reference.

export interface MockSurface {
  readonly theta_r_deg: number;
  readonly alpha_u: number;
  readonly alpha_v: number;
  readonly rho_d: number;
}

const RAD = Math.PI / 180;

/** Radiance for a lamp irradiance of 1; lamp 10° beyond the camera in the tilt plane. */
export function radiance(surface: MockSurface, thetaCDeg: number, phiSDeg: number): number {
  const half = (thetaCDeg + 5) * RAD;
  const phi = phiSDeg * RAD;
  const r = surface.theta_r_deg * RAD;
  const [hx, hn] = [Math.sin(half), Math.cos(half)];
  const [hv, hu] = [hx * Math.cos(phi), hx * Math.sin(phi)];
  const hm = hn * Math.cos(r) + hv * Math.sin(r);
  const x = hu / hm;
  const y = (hv * Math.cos(r) - hn * Math.sin(r)) / hm;
  const lobe = Math.exp(-((x / surface.alpha_u) ** 2) - (y / surface.alpha_v) ** 2) / (Math.PI * surface.alpha_u * surface.alpha_v * hm ** 4);
  const cosOut = Math.cos(thetaCDeg * RAD);
  const cosIn = Math.cos((thetaCDeg + 10) * RAD);
  return (0.045 * lobe) / (4 * cosOut) + (surface.rho_d / Math.PI) * cosIn;
}

/** Pseudo-random numbers in [0, 1) that repeat with their seed (mulberry32). */
export function random(seed: number): () => number {
  let a = seed >>> 0;
  return () => {
    a = (a + 0x6d2b79f5) >>> 0;
    let t = Math.imul(a ^ (a >>> 15), 1 | a);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
}
