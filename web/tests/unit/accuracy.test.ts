import { describe, expect, it } from 'vitest';

import { firstScene, levelsOff, linesOf, scenesOf, slopeOf, ticksOf } from '../../src/lib/accuracy';
import type { Accuracy, AccuracyPoint } from '../../src/lib/types';

const point = (method: string, seconds: number, error: number, quantity = 'rms'): AccuracyPoint => ({ scene: 's', method, seconds, error, quantity, reference: 'r' });
const of = (points: AccuracyPoint[]): Accuracy => ({ machine: '', written_at: null, seconds: 1, left_out: [], points, forecasts: [], rates: [], proofs: [] });

describe('error against run time', () => {
  it('has a line per method, without points that have no logarithm', () => {
    const found = of([point('a', 1, 0.1), point('b', 1, 0.2), point('a', 2, 0), { ...point('a', 1, 1), scene: 't' }]);
    expect(scenesOf(found)).toEqual(['s', 't']);
    expect(linesOf(found, 's').map((line) => [line.method, line.points.length])).toEqual([['a', 1], ['b', 1]]);
  });

  it('distinguishes the quantities of a scene', () => {
    const lines = linesOf(of([point('a', 1, 0.1, 'error, rms'), point('a', 1, 0.2, 'error, largest')]), 's');
    expect(lines.map((line) => line.method)).toEqual(['a (rms)', 'a (largest)']);
  });

  it('finds the slope of a square root, and none for too few points or too short a span', () => {
    const root = [0.1, 1, 7].map((s) => point('a', s, 0.3 / Math.sqrt(s)));
    expect(slopeOf(root)).toBeCloseTo(-0.5, 12);
    expect(slopeOf(root.slice(1))).toBeNull();
    // Errors that are squared at each step.
    expect(slopeOf([1, 2, 3, 4].map((s) => point('a', s, 0.1 ** (2 ** s))))).toBeNull();
    expect(slopeOf([1, 1.5, 2].map((s) => point('a', s, 1 / s)))).toBeNull();
  });

  it('fits no slope through a knee', () => {
    const knee = [[0.1, 1e-2], [1, 1e-3], [3, 4e-4], [9, 4e-4]].map(([s, e]) => point('a', s ?? 0, e ?? 0));
    expect(levelsOff(knee)).toBe(true);
    expect(slopeOf(knee)).toBeNull();
    expect(levelsOff(knee.slice(0, 3))).toBe(false);
    expect(slopeOf(knee.slice(0, 3))).not.toBeNull();
  });

  it('starts with a scene that has a curve', () => {
    const curve = [0.1, 1, 7].map((s) => ({ ...point('a', s, 1 / s), scene: 'curve' }));
    expect(firstScene(of([point('a', 1, 0.1), ...curve]))).toBe('curve');
    expect(firstScene(of([point('a', 1, 0.1), { ...point('b', 1, 1), scene: 't' }]))).toBe('s');
  });

  it('has round ticks within its range', () => {
    expect(ticksOf([0.9, 30])).toEqual([1, 2, 5, 10, 20]);
    expect(ticksOf([1e-5, 2]).map(Math.log10).map(Math.round)).toEqual([-5, -4, -3, -2, -1, 0]);
  });
});
