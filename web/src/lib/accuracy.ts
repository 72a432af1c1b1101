// What `ridged accuracy` measured, as lines of error over seconds.

import type { Accuracy, AccuracyPoint } from './types';

interface ErrorLine {
  readonly method: string;
  readonly points: readonly AccuracyPoint[];
  /** Slope of log error over log seconds by least squares. Null for fewer than three points, a span below a factor of 3, or points that are not on a straight line. */
  readonly slope: number | null;
  /** The error no longer falls at the end. */
  readonly level: boolean;
}

/** Scenes in the order of their measurement. */
export function scenesOf(accuracy: Accuracy): string[] {
  return [...new Set(accuracy.points.map((p) => p.scene))];
}

/** The scene shown at first: the first one that has a curve, else the first one. */
export function firstScene(accuracy: Accuracy): string {
  const scenes = scenesOf(accuracy);
  return scenes.find((scene) => linesOf(accuracy, scene).some((line) => line.slope !== null || line.level)) ?? scenes[0] ?? '';
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
  return [...groups].map(([method, points]) => ({ method, points, slope: slopeOf(points), level: levelsOff(points) }));
}

/** A point this far from the line, as a factor, excludes a power law: a solver that converges quadratically has none. */
const BENT = 4;

/** Slope above which an error does not fall with time: only what the method omits is left. */
const LEVEL = -0.25;

/** Whether the error no longer falls between the two points of the longest run times. */
export function levelsOff(points: readonly AccuracyPoint[]): boolean {
  const [before, last] = [...points].sort((a, b) => a.seconds - b.seconds).slice(-2);
  if (points.length < 3 || !before || !last) return false;
  return Math.log(last.error / before.error) > LEVEL * Math.log(last.seconds / before.seconds);
}

export function slopeOf(points: readonly AccuracyPoint[]): number | null {
  const x = points.map((p) => Math.log(p.seconds));
  const y = points.map((p) => Math.log(p.error));
  if (points.length < 3 || Math.max(...x) - Math.min(...x) < Math.log(3)) return null;
  const mean = (v: readonly number[]): number => v.reduce((a, b) => a + b, 0) / v.length;
  const [mx, my] = [mean(x), mean(y)];
  const xy = x.reduce((sum, v, i) => sum + (v - mx) * ((y[i] ?? my) - my), 0);
  const slope = xy / x.reduce((sum, v) => sum + (v - mx) ** 2, 0);
  const off = Math.max(...x.map((v, i) => Math.abs((y[i] ?? my) - my - slope * (v - mx))));
  // No slope is fitted through a knee.
  return off > Math.log(BENT) || (slope <= LEVEL && levelsOff(points)) ? null : slope;
}

/** A range of a logarithmic axis that contains all values, with a margin. */
export function around(values: readonly number[]): [number, number] {
  const [low, high] = [Math.min(...values), Math.max(...values)];
  return [low / 1.6, high * 1.6];
}

/** Marks at 1, 2 and 5 times the powers of ten within a range, or at the powers only if it spans many. */
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
