// A scene of the virtual ellipsometer as a form has it: what is typed in each field, what is wrong with it, the TOML that the
// fields make, and the fields of a TOML that they made.

import { angle, plain } from './format';
import { parseList, type ListOutcome } from './grid';
import { METALS } from './newsample';
import { typed } from './typed';

export const SURFACES = { ridges: 'ridges', rough: 'rough, random heights', flat: 'flat and smooth' } as const;
type SurfaceChoice = keyof typeof SURFACES;

/** Fields as typed; those that the chosen surface, material or layer does not have are ignored. */
export interface SceneDraft {
  surface: SurfaceChoice;
  thetaR: string;
  pitch: string;
  /** Radius of crests and valleys, µm; empty for sharp ones. */
  round: string;
  /** Along the ridges (u), or in all directions if `alphaV` is empty. */
  alphaU: string;
  alphaV: string;
  /** `dielectric`, `conductor` or the name of a metal in the daemon's tables. */
  material: string;
  n: string;
  k: string;
  /** Diffuse reflectance of the body; empty for a clear one. */
  rhoD: string;
  layer: boolean;
  layerN: string;
  /** κ of the layer; empty for a clear one. */
  layerK: string;
  layerThickness: string;
  /** Roughness of the layer's upper side; empty for a flat one. */
  layerAlpha: string;
  /** One angle of incidence, or a list; each is a trace. */
  angles: string;
  azimuth: string;
  wavelength: string;
}
export type SceneField = Exclude<keyof SceneDraft, 'surface' | 'material' | 'layer'>;

/** Ridges on plastic, as in `scenes/ridged-plastic.toml`. */
export const newScene = (): SceneDraft => ({
  surface: 'ridges', thetaR: '10', pitch: '100', round: '2', alphaU: '0.1', alphaV: '', material: 'dielectric', n: '1.5', k: '', rhoD: '0.3',
  layer: false, layerN: '1.5', layerK: '', layerThickness: '', layerAlpha: '', angles: '45', azimuth: '270', wavelength: '550',
});

/** Angles of incidence of one form: each is a trace of its own. */
export const ANGLES_MAX = 20;
/** Wavelengths that the tables of all metals cover, nm. */
const TABLES_NM = [365, 826] as const;
const PHOTONS = '1_000_000';

export interface SceneReading {
  /** What is wrong, by field. */
  readonly faults: Partial<Record<SceneField, string>>;
  /** Angles of incidence, degrees; empty with a fault. */
  readonly angles: readonly number[];
}

/** Checks the fields that the choices leave. */
export function readScene(draft: SceneDraft): SceneReading {
  const faults: Partial<Record<SceneField, string>> = {};
  const check = (field: SceneField, holds: (x: number) => boolean, expected: string, optional = false): void => {
    const x = typed(draft[field]);
    if (x === null ? !optional : !holds(x)) faults[field] = x !== null && Number.isNaN(x) ? `“${draft[field].trim()}” is not a number.` : `${expected}${optional ? ', or leave it empty' : ''}.`;
  };
  const above = (x: number): boolean => x > 0;
  if (draft.surface === 'ridges') {
    check('thetaR', (x) => x > 0 && x <= 85, 'Give an angle above 0° and up to 85°');
    check('pitch', above, 'Give a length above 0 µm');
    const most = 100 * (typed(draft.pitch) ?? Number.NaN);
    check('round', (x) => x >= 0 && !(x > most), most > 0 ? `Give a radius from 0 to ${plain(most, 6)} µm` : 'Give a radius of 0 µm or more', true);
  }
  if (draft.surface !== 'flat') {
    const smooth = draft.surface === 'ridges' && typed(draft.alphaV) === null;
    check('alphaU', above, smooth || draft.surface === 'rough' ? 'Give a roughness above 0' : 'Give the roughness along the ridges, too', smooth);
    check('alphaV', above, 'Give a roughness above 0', true);
  }
  if (draft.material === 'dielectric') {
    check('n', (x) => x >= 1 && x <= 10, 'Give an index from 1 to 10');
    const most = bodyMax(draft);
    check('rhoD', (x) => x >= 0 && !(x > most), most > 0 ? `Give a reflectance from 0 to ${plain(most, 3)}, which the boundary lets through` : 'Give a reflectance of 0 or more', true);
  } else if (draft.material === 'conductor') {
    check('n', (x) => x >= 0.01 && x <= 100, 'Give an index from 0.01 to 100');
    check('k', (x) => x > 0 && x <= 50, 'Give κ above 0 and up to 50');
  }
  if (draft.layer) {
    check('layerN', (x) => x >= 1 && x <= 10, 'Give an index from 1 to 10');
    const most = 0.1 * (typed(draft.layerN) ?? Number.NaN);
    check('layerK', (x) => x >= 0 && !(x > most), most > 0 ? `Give κ from 0 to ${plain(most, 4)}, a tenth of n: a layer with a larger κ is opaque` : 'Give κ of 0 or more', true);
    if (absorbs(draft)) check('layerThickness', above, 'Give a thickness above 0 µm: the layer absorbs');
    check('layerAlpha', above, 'Give a roughness above 0', true);
  }
  check('azimuth', (x) => Math.abs(x) <= 360, 'Give an angle from −360° to 360°');
  const [low, high] = draft.material in METALS ? TABLES_NM : ([100, 100_000] as const);
  check('wavelength', (x) => x >= low && x <= high, `Give a wavelength from ${low} to ${high} nm${draft.material in METALS ? ', which the tables of the metals cover' : ''}`);
  const angles = anglesOf(draft.angles);
  if (!angles.ok) faults.angles = angles.reason;
  return { faults, angles: angles.ok ? angles.values : [] };
}

function anglesOf(text: string): ListOutcome {
  // A single comma is a decimal mark here as in the other fields.
  const list = /^\s*\d+,\d+\s*°?\s*$/.test(text) ? parseList(text.replace(',', '.')) : parseList(text);
  if (!list.ok) return list;
  const out = list.values.find((x) => !(x >= 0 && x < 90));
  if (out !== undefined) return { ok: false, reason: `${angle(out)} is not an angle from 0° to below 90°.` };
  return list.values.length > ANGLES_MAX ? { ok: false, reason: `${list.values.length} angles: give at most ${ANGLES_MAX}. Each is a trace.` } : list;
}

const absorbs = (draft: SceneDraft): boolean => draft.layer && (typed(draft.layerK) ?? 0) > 0;

/** The largest diffuse reflectance that a body can show through its boundary: the square of the boundary's transmittance. NaN if an index is missing. */
function bodyMax(draft: SceneDraft): number {
  const eta = (typed(draft.n) ?? Number.NaN) / (draft.layer ? (typed(draft.layerN) ?? Number.NaN) : 1);
  return (1 - ((eta - 1) / (eta + 1)) ** 2) ** 2;
}

/** Whether a surface of the scene is random, so that several of the same statistics differ. */
export const isRandom = (draft: SceneDraft): boolean => draft.surface === 'rough' || (draft.layer && typed(draft.layerAlpha) !== null);

/** A number as TOML writes it. */
const number = (text: string): string => {
  const x = typed(text) ?? Number.NaN;
  return Number.isInteger(x) && Math.abs(x) < 1e15 ? x.toFixed(1) : String(x);
};

/** What is traced, in a few words: `ridges of 10° on dielectric, n 1.5`. */
export function sceneWords(draft: SceneDraft): string {
  const short = (text: string): string => plain(typed(text) ?? Number.NaN, 6);
  const material =
    draft.material === 'dielectric' ? `${typed(draft.rhoD) ? 'diffuse body' : 'dielectric'}, n ${short(draft.n)}` : draft.material === 'conductor' ? `metal, n ${short(draft.n)}, κ ${short(draft.k)}` : (METALS[draft.material] ?? draft.material);
  const surface = draft.surface === 'ridges' ? `ridges of ${short(draft.thetaR)}° on ${material}` : `${draft.surface} ${material}`;
  if (!draft.layer) return surface;
  return `${typed(draft.layerAlpha) === null ? 'flat' : 'rough'} layer, n ${short(draft.layerN)}${absorbs(draft) ? `, ${short(draft.layerThickness)} µm` : ''}, over ${surface}`;
}

/** The TOML of the fields, which must have no fault, for one angle of incidence in degrees. */
export function sceneOf(draft: SceneDraft, theta_i_deg: number): string {
  const given = (text: string): boolean => typed(text) !== null;
  const roughness = (u: string, v: string): string[] => (given(u) ? [`alpha_u = ${number(u)}`, `alpha_v = ${number(given(v) ? v : u)}`] : []);
  const interfaces: string[][] = [];
  if (draft.layer) {
    const k = absorbs(draft) ? `, k = ${number(draft.layerK)}` : '';
    interfaces.push([
      `shape = "${given(draft.layerAlpha) ? 'beckmann' : 'flat'}"`,
      ...roughness(draft.layerAlpha, ''),
      `below = { n = ${number(draft.layerN)}${k} }`,
      ...(k === '' ? [] : [`thickness_um = ${number(draft.layerThickness)}`]),
    ]);
  }
  const { surface, material } = draft;
  const rhoD = given(draft.rhoD) && typed(draft.rhoD) !== 0 ? `, rho_d = ${number(draft.rhoD)}` : '';
  const below = material === 'dielectric' ? `{ n = ${number(draft.n)}${rhoD} }` : material === 'conductor' ? `{ n = ${number(draft.n)}, k = ${number(draft.k)} }` : `"${material}"`;
  const round = given(draft.round) && typed(draft.round) !== 0 ? [`round_um = ${number(draft.round)}`] : [];
  interfaces.push([
    `shape = "${surface === 'rough' ? 'beckmann' : surface}"`,
    ...(surface === 'ridges' ? [`theta_r_deg = ${number(draft.thetaR)}`, `pitch_um = ${number(draft.pitch)}`, ...round] : []),
    ...(surface === 'flat' ? [] : roughness(draft.alphaU, draft.alphaV)),
    `below = ${below}`,
  ]);
  return [
    `# Lamp at ${plain(theta_i_deg, 6)}°: ${sceneWords(draft)}`,
    '',
    '[light]',
    `theta_i_deg = ${number(String(theta_i_deg))}`,
    `phi_i_deg = ${number(draft.azimuth)}`,
    `wavelength_nm = ${number(draft.wavelength)}`,
    ...interfaces.flatMap((lines) => ['', '[[interface]]', ...lines]),
    '',
    '[run]',
    `photons = ${PHOTONS}`,
    'seed = 1',
    '',
  ].join('\n');
}

/** The fields that make a TOML; null if the form cannot make it. */
export function draftOf(text: string): SceneDraft | null {
  const tables: Record<string, string>[] = [];
  for (const line of text.split('\n')) {
    if (line.startsWith('[')) tables.push({ '': line });
    const [, key, value] = /^(\w+) = (.+)$/.exec(line) ?? [];
    if (key !== undefined && value !== undefined) Object.assign(tables.at(-1) ?? {}, { [key]: value });
  }
  const [light] = tables;
  const interfaces = tables.filter((t) => t[''] === '[[interface]]');
  const base = interfaces.at(-1);
  if (!light || !base || interfaces.length > 2) return null;
  const top = interfaces.length === 2 ? interfaces[0] : undefined;
  const short = (written: string | undefined): string => (written === undefined ? '' : String(Number(written)));
  const inBelow = (table: Record<string, string> | undefined, key: string): string => short(new RegExp(`\\b${key} = ([-+.\\de]+)`).exec(table?.['below'] ?? '')?.[1]);
  const [, name] = /^"(\w+)"$/.exec(base['below'] ?? '') ?? [];
  const k = inBelow(base, 'k');
  const [u, v] = [short(base['alpha_u']), short(base['alpha_v'])];
  const fresh = newScene();
  const draft: SceneDraft = {
    surface: base['shape'] === '"ridges"' ? 'ridges' : base['shape'] === '"beckmann"' ? 'rough' : 'flat',
    thetaR: short(base['theta_r_deg']) || fresh.thetaR,
    pitch: short(base['pitch_um']) || fresh.pitch,
    round: short(base['round_um']),
    alphaU: u,
    alphaV: v === u ? '' : v,
    material: name ?? (k === '' ? 'dielectric' : 'conductor'),
    n: inBelow(base, 'n') || fresh.n,
    k,
    rhoD: inBelow(base, 'rho_d'),
    layer: top !== undefined,
    layerN: inBelow(top, 'n') || fresh.layerN,
    layerK: inBelow(top, 'k'),
    layerThickness: short(top?.['thickness_um']),
    layerAlpha: short(top?.['alpha_u']),
    angles: short(light['theta_i_deg']),
    azimuth: short(light['phi_i_deg']),
    wavelength: short(light['wavelength_nm']),
  };
  const { faults, angles } = readScene(draft);
  return Object.keys(faults).length === 0 && angles.length === 1 && sceneOf(draft, angles[0] ?? Number.NaN) === text ? draft : null;
}
