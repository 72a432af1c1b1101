// What the mock's camera sees: a panel in a dark surround. Its brightest pixel is full at 50 ms.

import { random } from './bench';
import { encodePng } from './png';

const SIZE_PX = 96;
const FULL_S = 0.05;
const FULL_DN = 65535;

/** The 8-bit picture of a frame. */
export function picture(id: number): Uint8Array {
  const noise = random(id);
  const grey = Array.from({ length: SIZE_PX * SIZE_PX }, (_, i) => {
    const [x, y] = [i % SIZE_PX, Math.floor(i / SIZE_PX)];
    const inside = x > 14 && x < 82 && y > 20 && y < 78;
    const ridge = 30 * Math.sin(x / 1.7) * (inside ? 1 : 0);
    return Math.min(255, Math.max(0, (inside ? 150 + 0.6 * (x - 48) + ridge : 16) + 14 * (noise() - 0.5)));
  });
  return encodePng(SIZE_PX, SIZE_PX, grey, { depth: 8 });
}

/** The answer to `POST /rig/preview`. */
export function lookThrough(id: number, exposures_s: readonly number[], suggest: number, pose: { readonly theta_c_deg: number; readonly referenced: boolean }): Record<string, unknown> {
  return {
    ...pose, phi_s_deg: 90, lamp: true, area: { left_px: 0, top_px: 0, width_px: SIZE_PX, height_px: SIZE_PX }, defects_known: true,
    frames: exposures_s.map((exposure_s) => {
      const at = (share: number): number => Math.min(FULL_DN, Math.round(200 + share * (FULL_DN - 200) * (exposure_s / FULL_S)));
      const max_dn = at(1);
      const pixels = Array.from({ length: 64 }, (_, bin) => {
        const share = ((bin + 0.5) * 1024) / Math.max(1, max_dn);
        return share > 1 ? 0 : Math.round(share < 0.05 ? 4000 : 900 * Math.exp(-(((share - 0.72) / 0.12) ** 2)));
      });
      return {
        id, exposure_s, taken_at: new Date().toISOString(), width_px: SIZE_PX, height_px: SIZE_PX, min_dn: 188, median_dn: at(0.66), mean_dn: at(0.5), max_dn,
        histogram: { bin_dn: 1024, pixels }, saturated_px: max_dn >= FULL_DN ? 2100 : 0, defect_px: 5, focus: max_dn >= FULL_DN ? 0.0001 : 0.0342,
        image: { path: `/api/v1/rig/preview/${id}/image.png`, width_px: SIZE_PX, height_px: SIZE_PX, low_dn: 190, high_dn: max_dn }, pixels: `/api/v1/rig/preview/${id}/pixels`,
      };
    }),
    suggestion: suggest === 0 ? null : { exposures_s: [0.035, 0.1].slice(0, suggest), reason: null },
  };
}
