// The plan of a scan: read from what a person types, written back into the fields, and in words.

import type { Recipe } from './openapi';
import { angle, counted, exposure } from './format';
import { parseList, printList, readWords, type ListOutcome } from './grid';
import { typed } from './typed';

/** A plan as a request states it. */
export type PlanRequest = Recipe['plan'];
export type PlanPose = NonNullable<PlanRequest['poses']>[number];

export const REPEATS_MAX = 100;

/** Grids by name, as the daemon knows them: tilts and azimuths, degrees. */
export const PRESETS = {
  paper: { name: 'quick', tilts: [-20, -10, 0, 10, 20], azimuths: [0, 90, 180] },
  full: { name: 'full', tilts: [-20, -15, -10, -5, 0, 5, 10, 15, 20], azimuths: [0, 30, 60, 90, 120, 150, 180, 210, 240, 270, 300, 330] },
} as const;

/** Poses and exposures as typed. */
export interface GridDraft {
  grid: keyof typeof PRESETS | 'custom' | 'poses';
  tilts: string;
  azimuths: string;
  /** Milliseconds; empty for the exposures of the rig. */
  exposures: string;
  repeats: string;
  /** Poses that a recipe, a scan or a script states one by one. */
  poses?: readonly PlanPose[];
}

export const newGrid = (): GridDraft => ({ grid: 'paper', tilts: '-20:5:20', azimuths: '0:30:330', exposures: '', repeats: '1' });

export type GridField = 'tilts' | 'azimuths' | 'exposures' | 'repeats';

interface GridReading {
  /** What is wrong, by field. */
  readonly faults: Partial<Record<GridField, string>>;
  /** The values that were read, as text. */
  readonly readings: readonly string[];
  /** Null with a fault. */
  readonly plan: PlanRequest | null;
}

/** Limits of an axis, degrees. */
interface Limits {
  readonly limit_min_deg: number;
  readonly limit_max_deg: number;
}
/** How far the rig moves. */
export interface Travel {
  readonly theta_c: Limits;
  readonly phi_s: Limits;
}
/** Exposures that the daemon accepts, milliseconds. */
const EXPOSURE_MS = { min: 0.001, max: 3.6e6 } as const;

/** The first value beyond limits, in words. */
function beyond(values: readonly number[], low: number, high: number, words: (x: number) => string): string | null {
  const outside = values.find((x) => x < low || x > high);
  return outside === undefined ? null : `${words(outside)} is not within ${words(low)} to ${words(high)}.`;
}

/** Reads the fields; with the travel of the rig, angles have to be within it. */
export function readGrid(draft: GridDraft, travel: Travel | null = null): GridReading {
  const lists: Partial<Record<Exclude<GridField, 'repeats'>, ListOutcome>> = {
    ...(draft.grid === 'custom' ? { tilts: parseList(draft.tilts), azimuths: parseList(draft.azimuths) } : {}),
    ...(draft.exposures.trim() === '' ? {} : { exposures: parseList(draft.exposures, 'ms') }),
  };
  const faults: Partial<Record<GridField, string>> = {};
  const valuesOf = (field: keyof typeof lists): readonly number[] => {
    const outcome = lists[field];
    if (outcome?.ok === false) faults[field] = outcome.reason;
    return outcome?.ok ? outcome.values : [];
  };
  const [tilts, azimuths, exposures] = [valuesOf('tilts'), valuesOf('azimuths'), valuesOf('exposures')];
  const degrees = (values: readonly number[], axis: Limits | undefined): string | null => (axis ? beyond(values, axis.limit_min_deg, axis.limit_max_deg, (x) => angle(x)) : null);
  const outside: Partial<Record<GridField, string | null>> = {
    tilts: degrees(tilts, travel?.theta_c),
    azimuths: degrees(azimuths, travel?.phi_s),
    exposures: beyond(exposures, EXPOSURE_MS.min, EXPOSURE_MS.max, (ms) => exposure(ms / 1000)),
  };
  for (const field of ['tilts', 'azimuths', 'exposures'] as const) {
    const fault = faults[field] ?? outside[field];
    if (fault != null) faults[field] = fault;
  }
  const repeats = typed(draft.repeats) ?? Number.NaN;
  if (!(Number.isInteger(repeats) && repeats >= 1 && repeats <= REPEATS_MAX)) faults.repeats = `Give a whole number from 1 to ${REPEATS_MAX}.`;
  const readings = [
    ...(tilts.length > 0 ? [readWords(tilts, 'tilt', (x) => angle(x))] : []),
    ...(azimuths.length > 0 ? [readWords(azimuths, 'azimuth', (x) => angle(x))] : []),
    ...(exposures.length > 0 ? [readWords(exposures, 'exposure', (ms) => exposure(ms / 1000))] : []),
  ];
  if (Object.keys(faults).length > 0) return { faults, readings, plan: null };
  return {
    faults,
    readings,
    plan: {
      repeats,
      ...visitsOf(draft, tilts, azimuths),
      ...(exposures.length > 0 ? { exposures_s: exposures.map((ms) => ms / 1000) } : {}),
    },
  };
}

function visitsOf(draft: GridDraft, tilts: readonly number[], azimuths: readonly number[]): Pick<PlanRequest, 'preset' | 'theta_c_deg' | 'phi_s_deg' | 'poses'> {
  if (draft.grid === 'custom') return { theta_c_deg: tilts, phi_s_deg: azimuths };
  return draft.grid === 'poses' ? { poses: draft.poses ?? [] } : { preset: draft.grid };
}

type Values = NonNullable<PlanRequest['theta_c_deg']>;

/** A list or a range of a request, value by value. */
export function valuesOf(values: Values | null | undefined): readonly number[] {
  if (values == null) return [];
  if (Array.isArray(values)) return values as readonly number[];
  const { from, to, step } = values as { from: number; to: number; step: number };
  return Array.from({ length: Math.floor((to - from) / step + 1e-9) + 1 }, (_, i) => Number((from + i * step).toPrecision(12)));
}

/** The tilts and azimuths of a plan's grid, degrees. It may take those of a preset and state its own others. */
export function gridListsOf(plan: PlanRequest): { readonly tilts: readonly number[]; readonly azimuths: readonly number[] } {
  const preset = PRESETS[plan.preset ?? 'full'];
  return {
    tilts: plan.theta_c_deg == null ? preset.tilts : valuesOf(plan.theta_c_deg),
    azimuths: plan.phi_s_deg == null ? preset.azimuths : valuesOf(plan.phi_s_deg),
  };
}

/** The poses of a plan, one by one. */
export function posesOf(plan: PlanRequest): readonly PlanPose[] {
  if (plan.poses != null && plan.poses.length > 0) return plan.poses;
  const { tilts, azimuths } = gridListsOf(plan);
  return tilts.flatMap((theta_c_deg) => azimuths.map((phi_s_deg) => ({ theta_c_deg, phi_s_deg })));
}

/** Parameters of every fit: ridge angle, two roughnesses, diffuse reflectance, gain, stray light and two offsets. A metal has no diffuse reflectance. */
const FITTED = { dielectric: 8, conductor: 7 } as const;

/** What is wrong with the number of poses of a plan; empty if a fit has enough. */
export function fewPosesWarning(plan: PlanRequest, material: keyof typeof FITTED): string {
  const [n, needed] = [posesOf(plan).length, FITTED[material] + 1];
  return n >= needed ? '' : `${counted(n, 'pose')} ${n === 1 ? 'is' : 'are'} too few: a fit needs at least ${needed} poses.`;
}

/** Seconds as milliseconds in the form of the fields. */
export const exposuresText = (seconds: readonly number[] | null | undefined): string => (seconds ?? []).map((s) => Number((1000 * s).toPrecision(6))).join(', ');

/** The fields that make a plan. */
export function gridOf(plan: PlanRequest): GridDraft {
  const { preset } = plan;
  const poses = plan.poses ?? [];
  const named = preset != null && plan.theta_c_deg == null && plan.phi_s_deg == null;
  const fresh = newGrid();
  const { tilts, azimuths } = gridListsOf(plan);
  return {
    grid: poses.length > 0 ? 'poses' : named ? preset : 'custom',
    ...(poses.length > 0 ? { poses } : {}),
    tilts: named ? fresh.tilts : printList(tilts),
    azimuths: named ? fresh.azimuths : printList(azimuths),
    exposures: exposuresText(plan.exposures_s),
    repeats: String(plan.repeats ?? 1),
  };
}

/** Poses in words: `5 tilts × 3 azimuths`, or `9 poses` where they are stated one by one. */
export function posesWords(tilts: number, azimuths: number, poses: readonly PlanPose[]): string {
  return poses.length > 0 ? counted(poses.length, 'pose') : `${counted(tilts, 'tilt')} × ${counted(azimuths, 'azimuth')}`;
}

/** What is unusual about exposures: those beyond 0.1 ms to 10 s; empty if nothing is. */
export function unusualExposure(exposures_s: readonly number[] = []): string {
  const odd = exposures_s.find((s) => s < 1e-4 || s > 10);
  return odd === undefined ? '' : `${exposure(odd)} is an unusually ${odd > 1 ? 'long' : 'short'} exposure.`;
}

/** Poses and exposures in one line: `5 tilts × 3 azimuths × 3 exposures, 2 frames of each`. */
export function planWords(plan: PlanRequest, rigExposures: number): string {
  const { tilts, azimuths } = gridListsOf(plan);
  const exposures = plan.exposures_s?.length ?? rigExposures;
  const repeats = plan.repeats ?? 1;
  return `${posesWords(tilts.length, azimuths.length, plan.poses ?? [])}${exposures > 0 ? ` × ${counted(exposures, 'exposure')}` : ''}${repeats > 1 ? `, ${repeats} frames of each` : ''}`;
}

/** What a recipe does, in one line. */
export function recipeWords(recipe: Recipe, rigExposures: number): string {
  const target = recipe.target_expanded_deg;
  return [planWords(recipe.plan, rigExposures), ...(target == null ? [] : [`target U(θr) ≤ ${angle(target, 6)}`])].join(' · ');
}
