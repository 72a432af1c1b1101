// What `ridged accuracy` measured, as lines of error over seconds.

import type { Accuracy, AccuracyPoint } from './types';

export interface ErrorLine {
  readonly method: string;
  readonly points: readonly AccuracyPoint[];
  /** Of log error over log seconds by least squares; null of fewer than three points or a span below a factor of 3. */
  readonly slope: number | null;
}

/** Scenes in the order in which they were measured. */
export function scenesOf(accuracy: Accuracy): string[] {
  return [...new Set(accuracy.points.map((p) => p.scene))];
}

/** Lines of a scene, one per method (and quantity, where there are several). */
export function linesOf(accuracy: Accuracy, scene: string): ErrorLine[] {
  const shown = accuracy.points.filter((p) => p.scene === scene && p.seconds > 0 && p.error > 0);
  const several = new Set(shown.map((p) => p.quantity)).size > 1;
  const groups = new Map<string, AccuracyPoint[]>();
  for (const p of shown) {
    const last = p.quantity.split(', ').at(-1) ?? p.quantity;
    const name = several ? `${p.method} (${last})` : p.method;
    groups.set(name, [...(groups.get(name) ?? []), p]);
  }
  return [...groups].map(([method, points]) => ({ method, points, slope: slopeOf(points) }));
}

export function slopeOf(points: readonly AccuracyPoint[]): number | null {
  const x = points.map((p) => Math.log(p.seconds));
  const y = points.map((p) => Math.log(p.error));
  if (points.length < 3 || Math.max(...x) - Math.min(...x) < Math.log(3)) return null;
  const mean = (v: readonly number[]): number => v.reduce((a, b) => a + b, 0) / v.length;
  const [mx, my] = [mean(x), mean(y)];
  const xy = x.reduce((sum, v, i) => sum + (v - mx) * ((y[i] ?? my) - my), 0);
  return xy / x.reduce((sum, v) => sum + (v - mx) ** 2, 0);
}

/** Values around all of some, on a logarithmic axis, with a little room. */
export function around(values: readonly number[]): [number, number] {
  const [low, high] = [Math.min(...values), Math.max(...values)];
  return [low / 1.6, high * 1.6];
}

/** Places of 1, 2 and 5 times the powers of ten within a range; of the powers alone where it spans many. */
export function ticksOf([low, high]: readonly [number, number]): number[] {
  const steps = high / low > 1e3 ? [1] : [1, 2, 5];
  const ticks: number[] = [];
  for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power++) {
    for (const step of steps) {
      const tick = step * 10 ** power;
      if (tick >= low * (1 - 1e-9) && tick <= high * (1 + 1e-9)) ticks.push(tick);
    }
  }
  return ticks;
}
