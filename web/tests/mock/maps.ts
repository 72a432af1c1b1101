// A finished map of the mock daemon: a small field of ridge angles with a defect, as the files that the daemon writes.

import { deflateSync } from 'node:zlib';

type Json = Record<string, unknown>;

/** A TIFF of one channel in deflated strips, as `src/map/write.rs` writes it. */
export function encodeTiff(values: Float32Array | Uint8Array, width: number, height: number, rowsPerStrip = height): Uint8Array<ArrayBuffer> {
  const isFloat = values instanceof Float32Array;
  const bytes = new Uint8Array(values.buffer, values.byteOffset, values.byteLength);
  const rowBytes = values.byteLength / height;
  const strips = Array.from({ length: Math.ceil(height / rowsPerStrip) }, (_, i) => deflateSync(bytes.subarray(i * rowsPerStrip * rowBytes, (i + 1) * rowsPerStrip * rowBytes)));
  const entries: [number, number, number[]][] = [
    [256, 4, [width]], [257, 4, [height]], [258, 3, [isFloat ? 32 : 8]], [259, 3, [8]], [262, 3, [1]],
    [273, 4, strips.map(() => 0)], [277, 3, [1]], [278, 4, [rowsPerStrip]], [279, 4, strips.map((s) => s.length)], [339, 3, [isFloat ? 3 : 1]],
  ];
  let at = 8 + 2 + 12 * entries.length + 4;
  const places = entries.map(([, type, numbers]) => {
    const size = (type === 3 ? 2 : 4) * numbers.length;
    const place = size > 4 ? at : null;
    if (size > 4) at += size;
    return place;
  });
  const offsets = strips.map((strip) => {
    const start = at;
    at += strip.length;
    return start;
  });
  const out = Buffer.alloc(at);
  out.write('II*\0', 0, 'latin1');
  out.writeUInt32LE(8, 4);
  out.writeUInt16LE(entries.length, 8);
  entries.forEach(([tag, type, own], i) => {
    const numbers = tag === 273 ? offsets : own;
    const entry = 10 + 12 * i;
    out.writeUInt16LE(tag, entry);
    out.writeUInt16LE(type, entry + 2);
    out.writeUInt32LE(numbers.length, entry + 4);
    const place = places[i] ?? null;
    if (place !== null) out.writeUInt32LE(place, entry + 8);
    numbers.forEach((x, n) => (type === 3 ? out.writeUInt16LE(x, (place ?? entry + 8) + 2 * n) : out.writeUInt32LE(x, (place ?? entry + 8) + 4 * n)));
  });
  strips.forEach((strip, i) => strip.copy(out, offsets[i]));
  return new Uint8Array(out);
}

export const [MAP_WIDTH, MAP_HEIGHT] = [40, 30];
const BITS = { not_converged: 1, at_bound: 2, not_identifiable: 4, misfit: 8, few_observations: 16, partly_masked: 32, border: 64, defect: 128 };

/** θr = 9.8° + 0.01° · column; the four pixels at the top left have none, one pixel is a defect of 14°. */
export function mapFiles(): Map<string, Uint8Array> {
  const n = MAP_WIDTH * MAP_HEIGHT;
  const theta = Float32Array.from({ length: n }, (_, i) => 9.8 + 0.01 * (i % MAP_WIDTH));
  const flags = new Uint8Array(n);
  for (const i of [0, 1, MAP_WIDTH, MAP_WIDTH + 1]) [theta[i], flags[i]] = [Number.NaN, BITS.few_observations];
  const defect = 20 * MAP_WIDTH + 30;
  [theta[defect], flags[defect]] = [14, BITS.defect];
  const same = (x: number): Float32Array => theta.map((value) => (Number.isNaN(value) ? value : x));
  const layers: Record<string, Float32Array | Uint8Array> = {
    theta_r_deg: theta, theta_r_deg_std: same(0.03), alpha_u: same(0.12), alpha_u_std: same(0.002), lean_azimuth_deg: same(179), lean_azimuth_deg_std: same(0.4), chi2_reduced: same(1.1), flags,
  };
  return new Map([...Object.entries(layers).map(([name, values]) => [`${name}.tif`, encodeTiff(values, MAP_WIDTH, MAP_HEIGHT, 7)] as const), ['defects.csv', new TextEncoder().encode('x_mm,y_mm\n')]]);
}

export function finishedMap(scan: number): Json {
  const n = MAP_WIDTH * MAP_HEIGHT;
  const spread = (median: number, width: number, std_shared: number): Json => ({ median, p5: median - width, p95: median + width, std_median: 0.03, std_shared });
  return {
    id: 1, scan_id: scan, state: 'completed', created_at: new Date().toISOString(), request: { scan_id: scan }, seconds: 2.1, pixels: n, pixels_with_value: n - 4, pixels_left_out: 0,
    parameters: { theta_r_deg: spread(9.995, 0.18, 0.04), alpha_u: spread(0.12, 0, 0.001), lean_azimuth_deg: spread(179, 0, 0.1) },
    lean_directions: [{ azimuth_deg: 179, share: 1 }],
    defects: [{ x_mm: 10.5, y_mm: 9.5, area_mm2: 1, worst: 'theta_r_deg', deviations: [{ parameter: 'theta_r_deg', value: 14, usual: 10, sigmas: 80 }] }],
    flags: { few_observations: 4, defect: 1 }, flag_bits: BITS, files: [...mapFiles().keys()], warnings: [], left_out: [],
  };
}
