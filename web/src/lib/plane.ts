// Curves over the plane of incidence, as panels of lines with error bars.

import type { Estimated, TracePlane } from './types';

/** A point of a line; `half` is its standard error. */
export interface LinePoint {
  readonly x: number;
  readonly y: number;
  readonly half: number;
}

export interface PlanePanel {
  readonly key: string;
  readonly title: string;
  readonly unit: string;
  readonly log: boolean;
  readonly range: readonly [number, number];
  readonly ticks: readonly number[];
  readonly lines: readonly { readonly name: string; readonly points: readonly LinePoint[] }[];
}

/** Degrees of polarisation, angles and differences are shown where their standard error is below this. */
const DOLP_STD_MAX = 0.25;
const AOP_STD_MAX_DEG = 15;
const DELTA_STD_MAX_DEG = 30;
const DIFFERENCE_STD_MAX = 0.03;
const DECADES = 4;

type PlanePoint = NonNullable<TracePlane['points']>[number];

/** What the ellipsometer reads in one direction for one state of the lamp; null where the trace has not settled a ratio. */
interface PlaneReading {
  /** I, Q, U, V, sr⁻¹. */
  readonly stokes: readonly Estimated[];
  readonly dolp: Estimated | null;
  readonly aop_deg: Estimated | null;
}

/** The readings of a direction, one for each state of the lamp. */
export function readingsOf(point: PlanePoint): PlaneReading[] {
  return point.readings.map(({ stokes, stokes_std, dolp, dolp_std, aop_deg, aop_std_deg }) => {
    return {
      stokes: stokes.map((value, i) => ({ value, std: stokes_std[i] ?? null })),
      dolp: known(dolp, dolp_std, DOLP_STD_MAX),
      aop_deg: known(aop_deg, aop_std_deg, AOP_STD_MAX_DEG),
    };
  });
}

/** Ψ, Δ and the degree of polarisation of a direction; null where the trace has not settled one, or an older version traced it. */
export function psiDeltaOf(point: PlanePoint): { readonly psi_deg: Estimated | null; readonly delta_deg: Estimated | null; readonly dop: Estimated | null } {
  const of = point.psi_delta;
  return {
    psi_deg: of ? known(of.psi_deg, of.psi_std_deg, AOP_STD_MAX_DEG) : null,
    delta_deg: of ? known(of.delta_deg, of.delta_std_deg, DELTA_STD_MAX_DEG) : null,
    dop: of ? known(of.dop, of.dop_std, DOLP_STD_MAX) : null,
  };
}

/** A ratio that the trace has settled. */
function known(value: number | null, std: number | null | undefined, most: number): Estimated | null {
  return value === null || std == null || std >= most ? null : { value, std };
}

/** The place of the direction with the most light of the first state of the lamp. */
export function brightest(points: readonly PlanePoint[]): number {
  const light = points.map((p) => p.readings[0]?.stokes[0] ?? 0);
  return light.indexOf(Math.max(...light));
}

/** DOLP, AOP and brightness for a state of the lamp; polarised and scalar if both were traced. */
export function panelsOf(plane: TracePlane, state: number): PlanePanel[] {
  const panels: PlanePanel[] = [];
  const rows = (plane.points ?? []).flatMap((p) => {
    const reading = p.readings[state];
    return reading ? [{ x: p.theta_s_deg, reading }] : [];
  });
  if (rows.length > 0) {
    const [dolp, aop]: [LinePoint[], LinePoint[]] = [[], []];
    for (const { x, reading } of rows) {
      const [i, noise] = [reading.stokes[0] ?? 0, Math.hypot(reading.stokes_std[1] ?? Number.NaN, reading.stokes_std[2] ?? Number.NaN)];
      if (reading.dolp === null || reading.aop_deg === null || !(i > 0)) continue;
      // Traces of older versions have no errors of ratios.
      const std = reading.dolp_std ?? noise / i;
      if (!(std >= DOLP_STD_MAX)) dolp.push({ x, y: reading.dolp, half: std });
      // An axis repeats after half a turn, so the error of the angle is half that of twice the angle.
      const turned = reading.aop_std_deg ?? ((0.5 * std) / reading.dolp) * (180 / Math.PI);
      if (reading.dolp > 0.01 && !(turned >= AOP_STD_MAX_DEG)) aop.push({ x, y: reading.aop_deg, half: turned });
    }
    panels.push({ key: 'dolp', title: 'Degree of linear polarisation', unit: '', log: false, range: [0, 1], ticks: [0, 0.25, 0.5, 0.75, 1], lines: [{ name: 'DOLP', points: dolp }] });
    panels.push({ key: 'aop', title: 'Angle of polarisation, from s to p', unit: '°', log: false, range: [-90, 90], ticks: [-90, -45, 0, 45, 90], lines: [{ name: 'AOP', points: aop }] });
  }
  if (plane.lobe && plane.lobe.length > 0) {
    const line = (of: 'polarised' | 'scalar'): LinePoint[] => (plane.lobe ?? []).map((p) => ({ x: p.theta_s_deg, y: p[of].value, half: p[of].std ?? 0 }));
    panels.push({ ...brightness([line('polarised'), line('scalar')], ['polarised', 'scalar']), key: 'lobe', title: 'Unpolarised lamp: polarised and scalar' });
    const d = plane.lobe.flatMap((p): LinePoint[] => {
      const std = (p.difference.std ?? Number.NaN) / p.scalar.value;
      return p.scalar.value > 0 && std <= DIFFERENCE_STD_MAX ? [{ x: p.theta_s_deg, y: (100 * p.difference.value) / p.scalar.value, half: 100 * std }] : [];
    });
    const most = Math.max(1, ...d.map((p) => Math.abs(p.y)));
    const top = [1, 2, 5, 10, 20, 50, 100].find((x) => x >= most) ?? 100;
    panels.push({ key: 'difference', title: '(polarised − scalar)/scalar', unit: '%', log: false, range: [-top, top], ticks: [-top, -top / 2, 0, top / 2, top], lines: [{ name: 'd', points: d }] });
  } else if (rows.length > 0) {
    const points = rows.map(({ x, reading }) => ({ x, y: reading.stokes[0] ?? 0, half: reading.stokes_std[0] ?? 0 }));
    panels.push({ ...brightness([points], ['I']), key: 'lobe', title: 'Brightness' });
  }
  return panels;
}

function brightness(lines: readonly LinePoint[][], names: readonly string[]): Omit<PlanePanel, 'key' | 'title'> {
  const bright = lines.flat().map((p) => p.y).filter((y) => y > 0);
  const top = Math.ceil(Math.log10(Math.max(...bright, Number.MIN_VALUE)) - 1e-9);
  const bottom = Math.max(top - DECADES, Math.floor(Math.log10(Math.min(...bright))));
  const ticks = Array.from({ length: top - bottom + 1 }, (_, i) => 10 ** (bottom + i));
  const floor = 10 ** bottom;
  return {
    unit: 'sr⁻¹', log: true, range: [floor, 10 ** top], ticks,
    lines: lines.map((points, i) => ({ name: names[i] ?? '', points: points.filter((p) => p.y >= floor) })),
  };
}

/** Lines through the points; a new line starts at a gap wider than `gap` or at a jump of more than half of `turn`. */
export function strokes(points: readonly LinePoint[], gap: number, turn: number | null): LinePoint[][] {
  const out: LinePoint[][] = [];
  let last: LinePoint | undefined;
  for (const point of points) {
    const joined = last !== undefined && point.x - last.x <= gap && !(turn !== null && Math.abs(point.y - last.y) > turn / 2);
    if (joined) out.at(-1)?.push(point);
    else out.push([point]);
    last = point;
  }
  return out;
}
