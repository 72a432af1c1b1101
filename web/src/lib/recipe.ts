// A recipe as typed: its fields, what is wrong with them, and the recipe that they make.

import { knownProblem, optionsOf, type KnownRow } from './fitoptions';
import { parseList, printList } from './grid';
import { exposuresText, gridOf, newGrid, readGrid, valuesOf, type GridDraft } from './plan';
import { typed } from './typed';
import type { Recipe } from './types';

export const NOTE_MAX = 4000;
const NAME_MAX = 200;
/** Bounds of an index n (of a plastic, of a metal), of κ and of a standard uncertainty. */
const INDEX = { dielectric: [1.0001, 10], conductor: [0.01, 100], k: [0, 50], std: [0, 50] } as const;

interface RecipeDraft {
  name: string;
  note: string;
  /** Degrees; empty for no target. */
  target: string;
  grid: GridDraft;
  /** Whether valid calibrations of earlier scans are used. */
  reuse: boolean;
  /** Empty fields of the references: as the rig's settings state. */
  dark: string;
  flatTilts: string;
  flatExposures: string;
  flatRepeats: string;
  every: string;
  variant: string;
  loss: string;
  judge: boolean;
  profile: boolean;
  known: KnownRow[];
  region: string;
  material: 'none' | 'dielectric' | 'conductor';
  eta: string;
  etaStd: string;
  k: string;
  kStd: string;
}

/** Fields as paths of the recipe, as the daemon names them in refusals. */
export const RECIPE_FIELDS = [
  'name', 'note', 'target_expanded_deg', 'plan.theta_c_deg', 'plan.phi_s_deg', 'plan.exposures_s', 'plan.repeats', 'plan.dark', 'plan.flat.theta_c_deg',
  'plan.flat.exposures_s', 'plan.flat.repeats', 'plan.reference_every', 'fit.region', 'fit.variant', 'fit.fix', 'fit.priors', 'material.eta', 'material.k',
] as const;
export type RecipeField = (typeof RECIPE_FIELDS)[number];
export type Faults = Partial<Record<string, string>>;

const text = (x: number | null | undefined): string => (x == null ? '' : String(x));

export function draftOf(recipe: Recipe | null): RecipeDraft {
  const { plan, fit, material } = recipe ?? { plan: null, fit: undefined, material: null };
  return {
    name: recipe?.name ?? '',
    note: recipe?.note ?? '',
    target: text(recipe?.target_expanded_deg),
    grid: plan ? gridOf(plan) : newGrid(),
    reuse: plan?.reuse_calibrations ?? true,
    dark: text(plan?.dark?.repeats),
    flatTilts: plan?.flat?.theta_c_deg == null ? '' : printList(valuesOf(plan.flat.theta_c_deg)),
    flatExposures: exposuresText(plan?.flat?.exposures_s),
    flatRepeats: text(plan?.flat?.repeats),
    every: text(plan?.reference_every),
    variant: fit?.variant ?? 'auto',
    loss: fit?.loss ?? 'linear',
    judge: fit?.judge ?? false,
    profile: fit?.profile ?? false,
    known: [
      ...Object.entries(fit?.fix ?? {}).map(([parameter, value]) => ({ parameter, value: String(value), std: '' })),
      ...Object.entries(fit?.priors ?? {}).map(([parameter, p]) => ({ parameter, value: String(p.value), std: String(p.std) })),
    ],
    region: fit?.region ?? '',
    material: material == null ? 'none' : material.k == null ? 'dielectric' : 'conductor',
    eta: text(material?.eta),
    etaStd: text(material?.eta_std),
    k: text(material?.k),
    kStd: text(material?.k_std),
  };
}

/** A number in a range; empty where that is allowed. */
function rangeFault(typedText: string, [low, high]: readonly [number, number], optional: boolean): string | null {
  const x = typed(typedText);
  if (x === null) return optional ? null : 'Give a number.';
  if (Number.isNaN(x)) return `“${typedText.trim()}” is not a number.`;
  return x < low || x > high ? `Must be from ${low} to ${high}.` : null;
}

function countFault(typedText: string): string | null {
  const n = typed(typedText);
  return n === null || (Number.isInteger(n) && n >= 0) ? null : 'Give a whole number, 0 for none, or leave it empty.';
}

function listFault(typedText: string, unit: '°' | 'ms'): string | null {
  if (typedText.trim() === '') return null;
  const list = parseList(typedText, unit);
  return list.ok ? null : list.reason;
}

/** What is wrong, by field. The grid and the known values show their own faults; they appear here under `grid` and `known`. */
export function recipeFaults(draft: RecipeDraft): Faults {
  const name = draft.name.trim();
  const target = typed(draft.target);
  const index = draft.material === 'none' ? null : (rangeFault(draft.eta, INDEX[draft.material], false) ?? rangeFault(draft.etaStd, INDEX.std, true));
  const kappa = draft.material === 'conductor' ? (rangeFault(draft.k, INDEX.k, false) ?? rangeFault(draft.kStd, INDEX.std, true)) : null;
  const all: Readonly<Record<string, string | null>> = {
    name: name === '' ? 'Give a name.' : [...name].length > NAME_MAX ? `At most ${NAME_MAX} characters.` : null,
    note: [...draft.note].length > NOTE_MAX ? `At most ${NOTE_MAX} characters.` : null,
    target_expanded_deg: target === null || target > 0 ? null : 'Give an angle above 0°, or leave it empty.',
    grid: readGrid(draft.grid).plan === null ? 'The grid is not complete.' : null,
    'plan.dark': countFault(draft.dark),
    'plan.flat.theta_c_deg': listFault(draft.flatTilts, '°'),
    'plan.flat.exposures_s': listFault(draft.flatExposures, 'ms'),
    'plan.flat.repeats': countFault(draft.flatRepeats),
    'plan.reference_every': countFault(draft.every),
    known: draft.known.some((row) => knownProblem(row, draft.known) !== null) ? 'A known value is not complete.' : null,
    'material.eta': index,
    'material.k': kappa,
  };
  return Object.fromEntries(Object.entries(all).filter((entry): entry is [string, string] => entry[1] !== null));
}

const listOf = (typedText: string, unit: '°' | 'ms'): number[] | null => {
  const list = typedText.trim() === '' ? null : parseList(typedText, unit);
  return list?.ok ? list.values : null;
};

/** The recipe of a draft without faults. What the form does not show is taken from the version that it changes. */
export function recipeOf(draft: RecipeDraft, before: Recipe | null): Recipe | null {
  const { plan } = readGrid(draft.grid);
  if (plan === null || Object.keys(recipeFaults(draft)).length > 0) return null;
  const [target, dark, every, flatRepeats] = [draft.target, draft.dark, draft.every, draft.flatRepeats].map(typed);
  const [flatTilts, flatExposures] = [listOf(draft.flatTilts, '°'), listOf(draft.flatExposures, 'ms')];
  const { variant: _, loss: __, judge: ___, profile: ____, fix: _____, priors: ______, region: _______, ...kept } = before?.fit ?? {};
  const { loss, judge, profile, fix, priors } = optionsOf({ ...draft, judge: draft.judge && draft.variant !== 'traced' });
  const fit = {
    ...kept,
    ...(draft.variant === 'auto' ? {} : { variant: draft.variant }),
    ...(draft.region.trim() === '' ? {} : { region: draft.region.trim() }),
    ...(loss ? { loss } : {}),
    ...(judge ? { judge } : {}),
    ...(profile ? { profile } : {}),
    ...(fix ? { fix } : {}),
    ...(priors ? { priors } : {}),
  };
  const [eta, etaStd, k, kStd] = [draft.eta, draft.etaStd, draft.k, draft.kStd].map(typed);
  const flat = {
    ...(flatTilts ? { theta_c_deg: flatTilts } : {}),
    ...(flatExposures ? { exposures_s: flatExposures.map((ms) => ms / 1000) } : {}),
    ...(flatRepeats == null ? {} : { repeats: flatRepeats }),
  };
  const recipe = {
    name: draft.name.trim(),
    ...(draft.note.trim() === '' ? {} : { note: draft.note.trim() }),
    ...(target == null ? {} : { target_expanded_deg: target }),
    plan: {
      ...plan,
      ...(draft.reuse ? {} : { reuse_calibrations: false }),
      ...(every == null ? {} : { reference_every: every }),
      ...(dark == null ? {} : { dark: { repeats: dark } }),
      ...(Object.keys(flat).length > 0 ? { flat } : {}),
    },
    ...(Object.keys(fit).length > 0 ? { fit } : {}),
    ...(draft.material === 'none' || eta == null ? {} : { material: { eta, ...(etaStd == null ? {} : { eta_std: etaStd }), ...(draft.material === 'conductor' && k != null ? { k, ...(kStd == null ? {} : { k_std: kStd }) } : {}) } }),
    ...(before?.layout ? { layout: before.layout } : {}),
  };
  // Options that are left out have the daemon's defaults.
  return recipe as Recipe;
}

/** What a version states that the form does not show and keeps, as text. */
export function keptWords(recipe: Recipe | null): string[] {
  const { bootstrap, starts, max_seconds, target_error, tolerance } = recipe?.fit ?? {};
  const named: Readonly<Record<string, number | null | undefined>> = { 'bootstrap series': bootstrap, starts, 'time limit of the fit, s': max_seconds, 'tracer’s error': target_error, tolerance };
  const { layout } = recipe ?? {};
  return [
    ...(layout ? [`${layout.patches_x} × ${layout.patches_y} patches of ${layout.patch_size_mm} mm`] : []),
    ...Object.entries(named).flatMap(([name, value]) => (value == null ? [] : [`${name} ${value}`])),
  ];
}
