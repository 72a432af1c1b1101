// Marks of a linear axis at round numbers.

export interface Marks {
  readonly at: readonly number[];
  /** Decimals that write each mark exactly. */
  readonly decimals: number;
}

/** At most about `most` marks between the ends, at multiples of 1, 2 or 5 times a power of ten. */
export function roundMarks(low: number, high: number, most: number): Marks {
  const raw = (high - low) / Math.max(1, most);
  if (!(raw > 0) || !Number.isFinite(raw)) return { at: [low], decimals: 4 };
  const exponent = Math.floor(Math.log10(raw));
  const factor = [1, 2, 5, 10].find((f) => f * 10 ** exponent >= raw * (1 - 1e-9)) ?? 10;
  const step = factor * 10 ** exponent;
  const first = Math.ceil(low / step - 1e-9);
  const last = Math.floor(high / step + 1e-9);
  return { at: Array.from({ length: Math.max(0, last - first + 1) }, (_, i) => (first + i) * step), decimals: Math.max(0, -(factor === 10 ? exponent + 1 : exponent)) };
}

/** Pixels beside an axis for its numbers in the font of the plots (11 px), with the gap to the plot. */
export function labelRoom(labels: readonly string[]): number {
  return Math.max(46, Math.ceil(10 + 6.6 * Math.max(0, ...labels.map((label) => label.length))));
}

/** Zero and two marks on each side of it, at a round number and at its half: the axis shows its scale on both sides. */
export function symmetricMarks(reach: number): readonly number[] {
  if (!(reach > 0) || !Number.isFinite(reach)) return [0];
  const power = 10 ** Math.floor(Math.log10(reach));
  const top = power * ([8, 6, 4, 2, 1].find((f) => f * power <= reach * (1 + 1e-9)) ?? 1);
  return [-top, -top / 2, 0, top / 2, top];
}
