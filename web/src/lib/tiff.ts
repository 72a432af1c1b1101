// Reads the maps that the daemon writes: TIFF of one channel, 32-bit float or 8-bit, in deflated strips (src/map/write.rs).
// A browser does not show them, and a library for all of TIFF is many times larger than what one fixed form needs.
//
// Source: TIFF 6.0 (Adobe 1992), sections 2 and 8; deflate as compression 8 (Adobe Photoshop TIFF Technical Notes, 2002).

/** Values row by row from the top left; NaN where a map has none. */
export interface Raster {
  readonly width: number;
  readonly height: number;
  readonly values: Float32Array;
}

/** Why bytes are not a map, as a sentence. */
export class NotAMap extends Error {}

const TAGS = { width: 256, height: 257, bits: 258, compression: 259, offsets: 273, samples: 277, rows: 278, lengths: 279, predictor: 317, format: 339 } as const;
/** Bytes of the field types BYTE, SHORT and LONG. */
const SIZES: Readonly<Record<number, number>> = { 1: 1, 3: 2, 4: 4 };
const [NONE, DEFLATE] = [1, 8];
const FLOAT = 3;
/** Larger maps are refused before memory is allocated. */
const PIXELS_MAX = 1 << 26;

export async function decodeTiff(buffer: ArrayBuffer): Promise<Raster> {
  const view = new DataView(buffer);
  const little = buffer.byteLength >= 8 && view.getUint16(0) === 0x4949;
  if (buffer.byteLength < 8 || (!little && view.getUint16(0) !== 0x4d4d) || view.getUint16(2, little) !== 42) throw new NotAMap('The file is not a TIFF.');
  try {
    return await read(view, little);
  } catch (cause) {
    if (cause instanceof NotAMap) throw cause;
    throw new NotAMap('The TIFF is damaged or cut short.', { cause });
  }
}

/** The numbers of each tag of the first directory. */
function directory(view: DataView, little: boolean): Map<number, number[]> {
  const at = view.getUint32(4, little);
  const tags = new Map<number, number[]>();
  for (let n = 0; n < view.getUint16(at, little); n++) {
    const entry = at + 2 + 12 * n;
    const size = SIZES[view.getUint16(entry + 2, little)];
    const count = view.getUint32(entry + 4, little);
    if (size === undefined || count > PIXELS_MAX) continue;
    const start = size * count <= 4 ? entry + 8 : view.getUint32(entry + 8, little);
    const number = (i: number): number => (size === 1 ? view.getUint8(start + i) : size === 2 ? view.getUint16(start + 2 * i, little) : view.getUint32(start + 4 * i, little));
    tags.set(view.getUint16(entry, little), Array.from({ length: count }, (_, i) => number(i)));
  }
  return tags;
}

async function read(view: DataView<ArrayBuffer>, little: boolean): Promise<Raster> {
  const tags = directory(view, little);
  const one = (tag: number, otherwise: number): number => tags.get(tag)?.[0] ?? otherwise;
  const [width, height, bits, compression] = [one(TAGS.width, 0), one(TAGS.height, 0), one(TAGS.bits, 1), one(TAGS.compression, NONE)];
  const isFloat = one(TAGS.format, 1) === FLOAT;
  if (width === 0 || height === 0 || width * height > PIXELS_MAX) throw new NotAMap(`A map of ${width} × ${height} pixels is not supported.`);
  const known = one(TAGS.samples, 1) === 1 && one(TAGS.predictor, 1) === 1 && (compression === NONE || compression === DEFLATE) && bits === (isFloat ? 32 : 8);
  if (!known) throw new NotAMap('The TIFF has a form that maps do not have.');

  const values = new Float32Array(width * height);
  const rows = Math.min(height, one(TAGS.rows, height));
  const [offsets, lengths] = [tags.get(TAGS.offsets) ?? [], tags.get(TAGS.lengths) ?? []];
  for (let strip = 0; strip * rows < height; strip++) {
    const bytes = new Uint8Array(view.buffer, offsets[strip] ?? Number.NaN, lengths[strip]);
    const plain = compression === NONE ? bytes.slice().buffer : await new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'))).arrayBuffer();
    const n = Math.min(rows, height - strip * rows) * width;
    if (plain.byteLength !== (n * bits) / 8) throw new NotAMap(`The TIFF is damaged: strip ${strip} has ${plain.byteLength} bytes.`);
    const of = new DataView(plain);
    for (let i = 0; i < n; i++) values[strip * rows * width + i] = isFloat ? of.getFloat32(4 * i, little) : of.getUint8(i);
  }
  return { width, height, values };
}
