// A map as a picture: its colours, and the sheet with title and colour bar that is saved.

import { CLASSES, type Range } from './mapvalues';
import { perceptual, STEPS, type Palette, type Rgb } from './perceptual';
import type { VerdictWord } from './types';

/** Colours of verdicts that differ also to colour-blind eyes (P. Tol 2021, vibrant). */
export const VERDICT_RGB: Readonly<Record<VerdictWord, Rgb>> = { pass: [0, 153, 136], fail: [204, 51, 17], 'cannot-tell': [238, 153, 51] };

/** Classes of the flags, in the order of precedence, with the colours of the daemon's picture (src/map/write.rs). */
export const FLAGS: readonly (readonly [string, string, Rgb])[] = [
  ['few_observations', 'too few observations', [150, 150, 150]],
  ['not_identifiable', 'not identifiable', [222, 222, 222]],
  ['not_converged', 'not converged', [90, 60, 120]],
  ['defect', 'defect', [204, 51, 17]],
  ['border', 'border', [0, 119, 187]],
  ['misfit', 'model error', [238, 119, 51]],
  ['at_bound', 'a parameter at its bound', [238, 51, 119]],
  ['partly_masked', 'some observations masked', [187, 204, 170]],
];
export const GOOD_RGB: Rgb = [0, 153, 136];

type Bits = Readonly<Record<string, number>>;

/** Names of the flags of a pixel. */
export function flagNames(value: number, bits: Bits): string[] {
  return FLAGS.filter(([key]) => (value & (bits[key] ?? 0)) !== 0).map(([, name]) => name);
}

function flagColour(value: number, bits: Bits): Rgb {
  return FLAGS.find(([key]) => (value & (bits[key] ?? 0)) !== 0)?.[2] ?? GOOD_RGB;
}

/** Pixels by their class, a number below 256. One without a colour is transparent. */
function paintClasses(classes: ArrayLike<number>, colours: readonly (Rgb | null)[]): Uint8ClampedArray<ArrayBuffer> {
  const table = new Uint8Array(4 * 256);
  colours.forEach((colour, i) => colour && table.set([...colour, 255], 4 * i));
  const rgba = new Uint8ClampedArray(4 * classes.length);
  for (let i = 0; i < classes.length; i++) {
    const of = 4 * (classes[i] ?? 0);
    for (let c = 0; c < 4; c++) rgba[4 * i + c] = table[of + c] ?? 0;
  }
  return rgba;
}

export function paintValues(values: Float32Array, { from, to }: Range, palette: Palette, dark: boolean): Uint8ClampedArray<ArrayBuffer> {
  const table = perceptual(palette, dark);
  const rgba = new Uint8ClampedArray(4 * values.length);
  values.forEach((value, i) => {
    if (!Number.isFinite(value)) return;
    const step = 3 * Math.round(Math.min(1, Math.max(0, (value - from) / (to - from))) * (STEPS - 1));
    for (let c = 0; c < 3; c++) rgba[4 * i + c] = table[step + c] ?? 0;
    rgba[4 * i + 3] = 255;
  });
  return rgba;
}

export function paintFlags(values: Float32Array, bits: Bits): Uint8ClampedArray<ArrayBuffer> {
  return paintClasses(values, Array.from({ length: 256 }, (_, value) => flagColour(value, bits)));
}

export function paintVerdicts(classes: Uint8Array): Uint8ClampedArray<ArrayBuffer> {
  return paintClasses(classes, CLASSES.map((of) => (of === 'none' ? null : VERDICT_RGB[of])));
}

/** The key of the picture: a colour bar with its ends, or colours with their meanings. */
export type Key = { readonly table: Uint8Array; readonly from: string; readonly to: string } | { readonly colours: readonly (readonly [string, Rgb])[] };

const css = ([r, g, b]: Rgb): string => `rgb(${r} ${g} ${b})`;

/** The picture with title and key on white, as a PNG. */
export async function sheetPng(rgba: Uint8ClampedArray<ArrayBuffer>, width: number, height: number, title: string, key: Key): Promise<Blob> {
  const scale = Math.max(1, Math.ceil(640 / width));
  const [margin, head, foot] = [24, 44, 'table' in key ? 60 : 24 + 24 * key.colours.length];
  const sheet = new OffscreenCanvas(scale * width + 2 * margin, head + scale * height + foot + 12);
  const ctx = sheet.getContext('2d');
  const small = new OffscreenCanvas(width, height);
  small.getContext('2d')?.putImageData(new ImageData(rgba, width, height), 0, 0);
  if (!ctx) throw new Error('The browser cannot draw the picture.');
  ctx.fillStyle = '#fff';
  ctx.fillRect(0, 0, sheet.width, sheet.height);
  ctx.fillStyle = '#dedede';
  ctx.fillRect(margin, head, scale * width, scale * height);
  ctx.imageSmoothingEnabled = false;
  ctx.drawImage(small, margin, head, scale * width, scale * height);
  ctx.fillStyle = '#282828';
  ctx.textBaseline = 'middle';
  ctx.font = '600 18px "Inter Variable", system-ui, sans-serif';
  ctx.fillText(title, margin, head / 2, scale * width);
  ctx.font = '16px "Inter Variable", system-ui, sans-serif';
  const top = head + scale * height + 16;
  if ('table' in key) {
    const n = key.table.length / 3;
    for (let x = 0; x < scale * width; x++) {
      const step = 3 * Math.round((x / (scale * width)) * (n - 1));
      ctx.fillStyle = css([key.table[step] ?? 0, key.table[step + 1] ?? 0, key.table[step + 2] ?? 0]);
      ctx.fillRect(margin + x, top, 1, 14);
    }
    ctx.fillStyle = '#282828';
    ctx.fillText(key.from, margin, top + 30);
    ctx.textAlign = 'right';
    ctx.fillText(key.to, margin + scale * width, top + 30);
  } else {
    key.colours.forEach(([words, rgb], i) => {
      ctx.fillStyle = css(rgb);
      ctx.fillRect(margin, top + 24 * i, 14, 14);
      ctx.fillStyle = '#282828';
      ctx.fillText(words, margin + 24, top + 24 * i + 8);
    });
  }
  return sheet.convertToBlob({ type: 'image/png' });
}
