// The measured shape of the part for a fit: a height file and the units that it may lack.

import { sizeProblem } from './files';
import { typed } from './typed';

/** Extensions of the height files that the daemon reads. */
export const HEIGHT_ENDINGS = ['.csv', '.txt', '.png', '.tif', '.tiff', '.x3p', '.sdf', '.tsv', '.dat', '.asc', '.prn', '.xyz'] as const;

/** `shape` of `POST /fits`. */
export interface ShapeRequest {
  readonly name: string;
  /** Base64. */
  readonly content: string;
  readonly pitch_um?: number | readonly [number, number];
  readonly height_unit_um?: number;
}

/** Units as typed, for files that do not state them. */
interface ShapeUnits {
  readonly pitch: string;
  readonly unit: string;
}

/** Sample spacing, µm: one number, or two for rows and columns (`0,5 0,6`, `0.5,0.6`, `0.5 × 0.6`). Null if empty, NaN if invalid. */
export function pitchOf(text: string): number | readonly [number, number] | null {
  const trimmed = text.trim();
  if (trimmed === '') return null;
  // A comma separates two numbers only if they contain points.
  const parts = trimmed.split(trimmed.includes('.') ? /\s*[,;×x]\s*|\s+/ : /\s*[;×x]\s*|\s+/);
  const [first, second, ...more] = parts.map((part) => positive(typed(part)));
  if (first === undefined || more.length > 0) return Number.NaN;
  if (second === undefined) return first;
  return Number.isNaN(first + second) ? Number.NaN : [first, second];
}

/** Micrometres per unit of height; null if empty, NaN if invalid. */
export function heightUnitOf(text: string): number | null {
  return text.trim() === '' ? null : positive(typed(text));
}

/** A partly typed number is not a length. */
function positive(x: number | null): number {
  return x !== null && x > 0 && Number.isFinite(x) ? x : Number.NaN;
}

/** Why a file cannot be sent as a shape, or null. The daemon checks its content. */
export function shapeProblem(file: { readonly name: string; readonly size: number }): string | null {
  const name = file.name.toLowerCase();
  if (!HEIGHT_ENDINGS.some((ending) => name.endsWith(ending))) return `${file.name} is not a height file. Supported extensions: ${HEIGHT_ENDINGS.join(', ')}.`;
  return sizeProblem([file]);
}

/** `shape` of the request; empty units are omitted. */
export function shapeRequest(name: string, content: string, units: ShapeUnits): ShapeRequest {
  const [pitch, unit] = [pitchOf(units.pitch), heightUnitOf(units.unit)];
  return { name, content, ...(pitch === null ? {} : { pitch_um: pitch }), ...(unit === null ? {} : { height_unit_um: unit }) };
}
