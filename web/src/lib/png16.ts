// Reads the 16-bit grey PNG frames that the daemon keeps. A browser's own decoder hands a canvas
// 8 bits per channel, so frames are decoded here without loss.
//
// Source: PNG specification, third edition (W3C 2025): chunk layout and CRC (clause 5), filters (9),
// zlib stream (10). Reads frames only: grey, 16 or 8 bits, not interlaced.

/** Counts (DN), row by row from the top left. */
export interface Frame16 {
  readonly width: number;
  readonly height: number;
  readonly pixels: Uint16Array;
}

/** Why bytes are not a frame, as a sentence. */
export class NotAFrame extends Error {}

const SIGNATURE = [0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a];
/** Larger frames are refused before memory is allocated. */
const PIXELS_MAX = 1 << 26;

let crcTable: Uint32Array | undefined;

/** CRC-32 of PNG chunks (reflected polynomial 0xEDB88320). */
export function crc32(bytes: Uint8Array): number {
  if (!crcTable) {
    crcTable = new Uint32Array(256);
    for (let n = 0; n < 256; n++) {
      let c = n;
      for (let k = 0; k < 8; k++) c = c & 1 ? 0xedb88320 ^ (c >>> 1) : c >>> 1;
      crcTable[n] = c >>> 0;
    }
  }
  let crc = 0xffffffff;
  for (const byte of bytes) crc = (crcTable[(crc ^ byte) & 0xff] ?? 0) ^ (crc >>> 8);
  return (crc ^ 0xffffffff) >>> 0;
}

async function inflate(parts: Uint8Array<ArrayBuffer>[], bytesExpected: number): Promise<Uint8Array> {
  const out = new Uint8Array(bytesExpected);
  let length = 0;
  try {
    const stream = new Blob(parts).stream().pipeThrough(new DecompressionStream('deflate'));
    const reader = stream.getReader();
    for (;;) {
      const { done, value } = await reader.read();
      if (done) break;
      if (length + value.length > bytesExpected) throw new NotAFrame('The PNG holds more data than its size allows.');
      out.set(value, length);
      length += value.length;
    }
  } catch (cause) {
    if (cause instanceof NotAFrame) throw cause;
    throw new NotAFrame('The PNG is damaged: its compressed data cannot be read.', { cause });
  }
  if (length !== bytesExpected) throw new NotAFrame(`The PNG is cut short: ${length} of ${bytesExpected} bytes.`);
  return out;
}

function paeth(a: number, b: number, c: number): number {
  const p = a + b - c;
  const pa = Math.abs(p - a);
  const pb = Math.abs(p - b);
  const pc = Math.abs(p - c);
  if (pa <= pb && pa <= pc) return a;
  return pb <= pc ? b : c;
}

/** Undoes the row filters in place; `raw` is (1 + rowBytes) × height, the filter type first. */
function unfilter(raw: Uint8Array, rowBytes: number, height: number, step: number): void {
  const at = (i: number): number => raw[i] ?? 0;
  for (let y = 0; y < height; y++) {
    const row = y * (rowBytes + 1);
    const start = row + 1;
    const above = start - (rowBytes + 1);
    const type = at(row);
    if (type > 4) throw new NotAFrame(`The PNG is damaged: row ${y} has the unknown filter ${type}.`);
    if (type === 0) continue;
    for (let x = 0; x < rowBytes; x++) {
      const left = x >= step ? at(start + x - step) : 0;
      const up = y > 0 ? at(above + x) : 0;
      let add: number;
      if (type === 1) add = left;
      else if (type === 2) add = up;
      else if (type === 3) add = (left + up) >> 1;
      else add = paeth(left, up, x >= step && y > 0 ? at(above + x - step) : 0);
      raw[start + x] = at(start + x) + add;
    }
  }
}

/** Reads a grey PNG of 16 bits (8 bits are widened as they are, 0 to 255). */
export async function decodePng16(bytes: Uint8Array<ArrayBuffer>): Promise<Frame16> {
  if (SIGNATURE.some((b, i) => bytes[i] !== b)) throw new NotAFrame('The file is not a PNG.');
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let width = 0;
  let height = 0;
  let depth = 0;
  let ended = false;
  const parts: Uint8Array<ArrayBuffer>[] = [];
  for (let at = 8; at < bytes.length && !ended; ) {
    if (at + 12 > bytes.length) throw new NotAFrame('The PNG is cut short.');
    const length = view.getUint32(at);
    const end = at + 12 + length;
    if (end > bytes.length) throw new NotAFrame('The PNG is cut short.');
    const type = String.fromCharCode(...bytes.subarray(at + 4, at + 8));
    if (crc32(bytes.subarray(at + 4, end - 4)) !== view.getUint32(end - 4)) {
      throw new NotAFrame(`The PNG is damaged: the check sum of its ${type} chunk is wrong.`);
    }
    if (type === 'IHDR') {
      width = view.getUint32(at + 8);
      height = view.getUint32(at + 12);
      depth = view.getUint8(at + 16);
      const colour = view.getUint8(at + 17);
      const interlaced = view.getUint8(at + 20);
      if (colour !== 0 || (depth !== 16 && depth !== 8)) throw new NotAFrame('The PNG is not 16-bit grey.');
      if (interlaced !== 0) throw new NotAFrame('The PNG is interlaced; frames are not.');
      if (width === 0 || height === 0 || width * height > PIXELS_MAX) {
        throw new NotAFrame(`A frame of ${width} × ${height} pixels is not supported.`);
      }
    } else if (type === 'IDAT') {
      parts.push(bytes.subarray(at + 8, end - 4));
    } else if (type === 'IEND') {
      ended = true;
    }
    at = end;
  }
  if (!ended || width === 0) throw new NotAFrame('The PNG is cut short.');

  const step = depth / 8;
  const rowBytes = width * step;
  const raw = await inflate(parts, (rowBytes + 1) * height);
  unfilter(raw, rowBytes, height, step);
  const pixels = new Uint16Array(width * height);
  for (let y = 0; y < height; y++) {
    let i = y * (rowBytes + 1) + 1;
    for (let x = 0; x < width; x++, i += step) {
      pixels[y * width + x] = step === 2 ? ((raw[i] ?? 0) << 8) | (raw[i + 1] ?? 0) : (raw[i] ?? 0);
    }
  }
  return { width, height, pixels };
}
