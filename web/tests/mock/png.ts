// Writes the PNG files that tests read back; the decoder under test shares no code with it.

import { crc32, deflateSync } from 'node:zlib';

function chunk(type: string, body: Buffer): Buffer {
  const head = Buffer.alloc(8);
  head.writeUInt32BE(body.length, 0);
  head.write(type, 4, 'latin1');
  const sum = Buffer.alloc(4);
  sum.writeUInt32BE(crc32(Buffer.concat([head.subarray(4), body])), 0);
  return Buffer.concat([head, body, sum]);
}

interface PngOptions {
  /** Row filter, 0 to 4; a function chooses by row. */
  readonly filter?: number | ((row: number) => number);
  readonly depth?: 8 | 16;
  /** Bytes per IDAT chunk. */
  readonly split?: number;
  readonly colour?: number;
  readonly interlaced?: number;
}

/** A grey PNG of `pixels`, row by row from the top left. */
export function encodePng(width: number, height: number, pixels: ArrayLike<number>, options: PngOptions = {}): Uint8Array<ArrayBuffer> {
  const step = (options.depth ?? 16) / 8;
  const rowBytes = width * step;
  const plain = Buffer.alloc(rowBytes * height);
  for (let i = 0; i < width * height; i++) {
    if (step === 2) plain.writeUInt16BE(pixels[i] ?? 0, 2 * i);
    else plain.writeUInt8(pixels[i] ?? 0, i);
  }
  const raw = Buffer.alloc((rowBytes + 1) * height);
  for (let y = 0; y < height; y++) {
    const filter = typeof options.filter === 'function' ? options.filter(y) : (options.filter ?? 0);
    raw[y * (rowBytes + 1)] = filter;
    for (let x = 0; x < rowBytes; x++) {
      const a = x >= step ? (plain[y * rowBytes + x - step] ?? 0) : 0;
      const b = y > 0 ? (plain[(y - 1) * rowBytes + x] ?? 0) : 0;
      const c = x >= step && y > 0 ? (plain[(y - 1) * rowBytes + x - step] ?? 0) : 0;
      const p = a + b - c;
      const [pa, pb, pc] = [Math.abs(p - a), Math.abs(p - b), Math.abs(p - c)];
      const paeth = pa <= pb && pa <= pc ? a : pb <= pc ? b : c;
      const predicted = [0, a, b, (a + b) >> 1, paeth][filter] ?? 0;
      raw[y * (rowBytes + 1) + 1 + x] = ((plain[y * rowBytes + x] ?? 0) - predicted) & 255;
    }
  }
  const head = Buffer.alloc(13);
  head.writeUInt32BE(width, 0);
  head.writeUInt32BE(height, 4);
  head.set([options.depth ?? 16, options.colour ?? 0, 0, 0, options.interlaced ?? 0], 8);
  const packed = deflateSync(raw, { level: 3 });
  const parts: Buffer[] = [];
  for (let at = 0; at < packed.length; at += options.split ?? packed.length) {
    parts.push(chunk('IDAT', packed.subarray(at, at + (options.split ?? packed.length))));
  }
  const file = Buffer.concat([
    Buffer.from([0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a]),
    chunk('IHDR', head),
    chunk('tEXt', Buffer.from('Comment\0a chunk to skip', 'latin1')),
    ...parts,
    chunk('IEND', Buffer.alloc(0)),
  ]);
  return new Uint8Array(file);
}
