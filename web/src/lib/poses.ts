// Frames of a scan, sorted into a grid of poses: tilts as rows, azimuths as columns.

import { colourMap, type ColourMapName } from './colourmap';
import type { FrameRow } from './types';

export interface PoseGrid {
  readonly tilts_deg: readonly number[];
  readonly azimuths_deg: readonly number[];
  /** `cells[row][column]`: frames at that pose in order of exposure, then repeat; empty if none. */
  readonly cells: readonly (readonly FrameRow[])[][];
}

/** Stages read back within a few thousandths of a degree; poses of a grid are farther apart than this. */
const SAME_DEG = 0.25;

function levels(values: readonly number[]): number[] {
  const out: number[] = [];
  for (const v of [...values].sort((a, b) => a - b)) {
    const last = out.at(-1);
    if (last === undefined || v - last > SAME_DEG) out.push(v);
  }
  return out.map((v) => {
    const rounded = Math.round(v * 100) / 100;
    return rounded === 0 ? 0 : rounded;
  });
}

function nearest(list: readonly number[], value: number): number {
  let best = 0;
  list.forEach((v, i) => {
    if (Math.abs(v - value) < Math.abs((list[best] ?? 0) - value)) best = i;
  });
  return best;
}

/** Grid of `frames`; `plannedTilts` and `plannedAzimuths` add poses without frames. */
export function poseGrid(frames: readonly FrameRow[], plannedTilts: readonly number[] = [], plannedAzimuths: readonly number[] = []): PoseGrid {
  const tilts = levels([...plannedTilts, ...frames.map((f) => f.theta_c_deg)]);
  const azimuths = levels([...plannedAzimuths, ...frames.map((f) => f.phi_s_deg)]);
  const cells: FrameRow[][][] = tilts.map(() => azimuths.map(() => []));
  for (const frame of frames) {
    cells[nearest(tilts, frame.theta_c_deg)]?.[nearest(azimuths, frame.phi_s_deg)]?.push(frame);
  }
  for (const row of cells) {
    for (const cell of row) cell.sort((a, b) => a.exposure_s - b.exposure_s || a.repeat - b.repeat);
  }
  return { tilts_deg: tilts, azimuths_deg: azimuths, cells };
}

/** Share of full pixels above which a frame counts as saturated; every sensor has a few hot pixels. */
const SATURATED_SHARE_MIN = 0.002;
/** Pixels of a frame of unknown size: 128 × 128. */
const PIXELS_ASSUMED = 128 * 128;

/** Whether more pixels are full than hot pixels explain. */
export function isSaturated(frame: FrameRow): boolean {
  const pixels = frame.width_px !== undefined && frame.height_px !== undefined ? frame.width_px * frame.height_px : PIXELS_ASSUMED;
  return (frame.saturated_px ?? 0) > SATURATED_SHARE_MIN * pixels;
}

/** The best frame of a pose: the longest exposure that is not saturated, else the shortest. */
export function bestExposure(frames: readonly FrameRow[]): FrameRow | null {
  const fine = frames.filter((f) => f.accepted && !isSaturated(f));
  return fine.at(-1) ?? frames[0] ?? null;
}

/** Mean counts per second of a frame, DN/s; 0 without a mean. */
export function rateOf(frame: FrameRow | null): number {
  return frame ? (frame.mean_dn ?? 0) / frame.exposure_s : 0;
}

/** Colour of a pose in the map: counts per second of its best frame, over those of the brightest pose. */
export function poseColour(frames: readonly FrameRow[], name: ColourMapName, top: number): string {
  const at = 3 * Math.round(255 * Math.min(1, rateOf(bestExposure(frames)) / top));
  const table = colourMap(name);
  return `rgb(${table[at] ?? 0} ${table[at + 1] ?? 0} ${table[at + 2] ?? 0})`;
}

/** The next pose with frames in the direction of an arrow key; null if there is none. */
export function stepTo(grid: PoseGrid, key: string, row: number, column: number): { readonly row: number; readonly column: number } | null {
  const move = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0] }[key];
  if (!move) return null;
  const [down = 0, right = 0] = move;
  let [i, j] = [row + down, column + right];
  while (grid.cells[i]?.[j] !== undefined) {
    if ((grid.cells[i]?.[j]?.length ?? 0) > 0) return { row: i, column: j };
    [i, j] = [i + down, j + right];
  }
  return null;
}
