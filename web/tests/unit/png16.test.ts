import { describe, expect, it } from 'vitest';

import { crc32, decodePng16, NotAFrame } from '../../src/lib/png16';
import { random } from '../mock/bench';
import { encodePng } from '../mock/png';

function noise(width: number, height: number, top = 65536): Uint16Array {
  const next = random(width * 1000 + height);
  return Uint16Array.from({ length: width * height }, () => Math.floor(next() * top));
}

describe('decodePng16', () => {
  it.each([0, 1, 2, 3, 4])('gives back every count under row filter %i', async (filter) => {
    const pixels = noise(13, 9);
    const frame = await decodePng16(encodePng(13, 9, pixels, { filter }));
    expect([frame.width, frame.height]).toEqual([13, 9]);
    expect(frame.pixels).toEqual(pixels);
  });

  it('follows a filter that changes from row to row, over many small chunks', async () => {
    const pixels = noise(31, 17);
    const frame = await decodePng16(encodePng(31, 17, pixels, { filter: (row) => row % 5, split: 37 }));
    expect(frame.pixels).toEqual(pixels);
  });

  it('keeps the low byte of a count, which a canvas would drop', async () => {
    const frame = await decodePng16(encodePng(3, 1, [0x0100, 0x01ff, 0xffff]));
    expect([...frame.pixels]).toEqual([256, 511, 65535]);
  });

  it('reads 8-bit grey as it is', async () => {
    const pixels = noise(5, 4, 256);
    const frame = await decodePng16(encodePng(5, 4, pixels, { depth: 8, filter: 4 }));
    expect(frame.pixels).toEqual(pixels);
  });

  it('refuses every truncation of a file', async () => {
    const bytes = encodePng(4, 3, noise(4, 3), { filter: 2 });
    for (let end = 0; end < bytes.length; end++) {
      await expect(decodePng16(bytes.slice(0, end)), `${end} of ${bytes.length} bytes`).rejects.toBeInstanceOf(NotAFrame);
    }
  });

  it('refuses a file with any one byte of its chunks changed', async () => {
    const bytes = encodePng(4, 3, noise(4, 3));
    for (let at = 0; at < bytes.length; at++) {
      const broken = bytes.slice();
      broken[at] = (broken[at] ?? 0) ^ 0x10;
      await expect(decodePng16(broken), `byte ${at}`).rejects.toBeInstanceOf(NotAFrame);
    }
  });

  it('states why a file is not a frame', async () => {
    await expect(decodePng16(new TextEncoder().encode('<html>'))).rejects.toThrow('not a PNG');
    await expect(decodePng16(encodePng(2, 2, [1, 2, 3, 4], { colour: 2 }))).rejects.toThrow('not 16-bit grey');
    await expect(decodePng16(encodePng(2, 2, [1, 2, 3, 4], { interlaced: 1 }))).rejects.toThrow('interlaced');
  });
});

describe('crc32', () => {
  it('gives the check value of the standard', () => {
    expect(crc32(new TextEncoder().encode('123456789'))).toBe(0xcbf43926);
  });
});
