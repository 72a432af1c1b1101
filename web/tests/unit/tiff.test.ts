import { deflateSync } from 'node:zlib';

import { describe, expect, it } from 'vitest';

import { decodeTiff, NotAMap } from '../../src/lib/tiff';
import { encodeTiff } from '../mock/maps';

describe('a TIFF of a map', () => {
  it('is read with all its bits, whatever its strips', async () => {
    const values = Float32Array.from({ length: 7 * 5 }, (_, i) => (i === 3 ? Number.NaN : Math.fround(10 + i * 1e-6)));
    for (const rows of [1, 2, 5]) expect(await decodeTiff(encodeTiff(values, 7, 5, rows).buffer)).toEqual({ width: 7, height: 5, values });
    const flags = Uint8Array.from([0, 16, 128, 255]);
    expect((await decodeTiff(encodeTiff(flags, 2, 2).buffer)).values).toEqual(Float32Array.from(flags));
  });

  it('may be big-endian and not compressed', async () => {
    // Written by hand after TIFF 6.0: one strip of 2 × 1 floats, 1.5 and −2.
    const view = new DataView(new ArrayBuffer(8 + 2 + 8 * 12 + 4 + 8));
    view.setUint32(0, 0x4d4d002a);
    view.setUint32(4, 8);
    view.setUint16(8, 8);
    [[256, 3, 2], [257, 3, 1], [258, 3, 32], [259, 3, 1], [273, 4, 110], [278, 3, 1], [279, 4, 8], [339, 3, 3]].forEach(([tag = 0, type = 0, value = 0], i) => {
      view.setUint16(10 + 12 * i, tag);
      view.setUint16(12 + 12 * i, type);
      view.setUint32(14 + 12 * i, 1);
      if (type === 3) view.setUint16(18 + 12 * i, value);
      else view.setUint32(18 + 12 * i, value);
    });
    view.setFloat32(110, 1.5);
    view.setFloat32(114, -2);
    expect([...(await decodeTiff(view.buffer)).values]).toEqual([1.5, -2]);
  });

  it('is refused with the reason if it is damaged or of another form', async () => {
    const good = encodeTiff(new Float32Array(12), 4, 3);
    await expect(decodeTiff(deflateSync('not a TIFF at all').buffer as ArrayBuffer)).rejects.toThrow('The file is not a TIFF.');
    await expect(decodeTiff(good.slice(0, good.length - 4).buffer)).rejects.toThrow(NotAMap);
    await expect(decodeTiff(good.slice(0, 40).buffer)).rejects.toThrow('damaged or cut short');
    const predicted = good.slice();
    // Compression 5 (LZW) in place of 8.
    predicted[10 + 12 * 3 + 8] = 5;
    await expect(decodeTiff(predicted.buffer)).rejects.toThrow('form that maps do not have');
  });
});
