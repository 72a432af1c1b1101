// The file of a frame.

import { random } from './bench';
import { SIZE_PX } from './lab';
import { encodePng } from './png';

/** Counts with noise about a mean that falls towards the edge. */
export function frameImage(id: number, mean: number): Uint8Array {
  const noise = random(id);
  const pixels = new Uint16Array(SIZE_PX * SIZE_PX);
  for (let y = 0; y < SIZE_PX; y++) {
    for (let x = 0; x < SIZE_PX; x++) {
      const r2 = ((x - SIZE_PX / 2) ** 2 + (y - SIZE_PX / 2) ** 2) / (SIZE_PX / 2) ** 2;
      const shot = Math.sqrt(2 * mean) * 1.7 * (noise() + noise() + noise() - 1.5);
      pixels[y * SIZE_PX + x] = Math.max(0, Math.min(65535, Math.round(200 + (mean - 200) * (1.03 - 0.06 * r2) + shot)));
    }
  }
  // One known pixel, so that a test can point at it.
  pixels[3 * SIZE_PX + 5] = 12345;
  return encodePng(SIZE_PX, SIZE_PX, pixels, { filter: 2 });
}
