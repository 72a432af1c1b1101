// Codes and names of the daemon as text.

import type { Fit, JobKind, JobProgress, JobState, Parameter, Sample, Scan, ScanState, VerdictWord } from './types';

interface ParameterWords {
  /** Symbol in plain text; the part after `_` becomes a subscript. */
  readonly symbol: string;
  readonly name: string;
  readonly unit: string;
}

/** Parameters in the order of the table. One that is not listed is shown by its key. */
export const PARAMETERS: Readonly<Record<string, ParameterWords>> = {
  theta_r_deg: { symbol: 'θ_r', name: 'ridge angle', unit: '°' },
  alpha_u: { symbol: 'α_u', name: 'roughness along the ridges', unit: '' },
  alpha_v: { symbol: 'α_v', name: 'roughness across the ridges', unit: '' },
  rho_d: { symbol: 'ρ_d', name: 'diffuse reflectance', unit: '' },
  scale: { symbol: 'g', name: 'gain of the signal', unit: '' },
  background: { symbol: 'B', name: 'stray light', unit: '' },
  azimuth_offset_deg: { symbol: 'Δφ_s', name: 'azimuth offset', unit: '°' },
  tilt_offset_deg: { symbol: 'Δθ_c', name: 'tilt offset', unit: '°' },
  translucency: { symbol: 'τ', name: 'share of the body’s light that leaves evenly', unit: '' },
  crest_radius: { symbol: 'R/p', name: 'radius of the crests over the facets’ length', unit: '' },
  land_share: { symbol: 'f', name: 'share of flat lands', unit: '' },
};

/** Parameters that a request may hold or give a prior for: those of the report, and the index of refraction. */
export const KNOWABLE: Readonly<Record<string, ParameterWords>> = {
  ...PARAMETERS,
  eta: { symbol: 'n', name: 'refractive index', unit: '' },
  k: { symbol: 'κ', name: 'extinction coefficient of a metal', unit: '' },
};

/** Codes of findings in words. */
export const FINDINGS: Readonly<Record<string, string>> = {
  tails: 'Tails of the lobe',
  'rounded-crests': 'Rounded crests',
  'flat-lands': 'Flat lands',
  translucent: 'Translucent body',
  'wedge-across': 'Wedge across the ridges',
  'lamp-azimuth': 'Lamp beside its stated place',
  'white-reference': 'White reference not Lambertian',
  'non-linear': 'Camera not linear',
  'lamp-drift': 'Lamp drift',
  index: 'Refractive index',
  'bad-block': 'A run of poses deviates',
  'bad-pose': 'A pose deviates',
};

/** Quantities of maps and verdicts in addition to the parameters. */
export const QUANTITIES: Readonly<Record<string, ParameterWords>> = {
  ...PARAMETERS,
  lean_azimuth_deg: { symbol: 'φ_lean', name: 'azimuth of the lean', unit: '°' },
  chi2_reduced: { symbol: 'χ²', name: 'reduced chi square', unit: '' },
  contrast_mean: { symbol: 'C', name: 'mean contrast after rotation', unit: '' },
  contrast_michelson_mean: { symbol: 'C_M', name: 'mean Michelson contrast', unit: '' },
};

/** The planes that angles can refer to. */
export const PLANES: Readonly<Record<string, string>> = {
  turntable: 'The ridge angle is relative to the turntable. The rig’s settings do not state how level samples are on it.',
  sample: 'The ridge angle is relative to the sample’s mean plane. The uncertainty includes the sample’s tilt on the turntable.',
};

/** Whether a parameter was held at its value: it has no uncertainty. */
export const isHeld = ({ value, std }: Pick<Parameter, 'value' | 'std'>): boolean => value !== null && std === null;

/** What is known of a parameter beside the report. */
interface KnownOfParameter {
  /** The request held it at a value. */
  readonly held?: boolean;
  /** The part is a metal, which has no such parameter. */
  readonly metal?: boolean;
}

/** Whether the data determine a parameter, in words. */
export function identifiability(parameter: Parameter, known: KnownOfParameter = {}): { word: string; tone: 'good' | 'plain' | 'bad'; detail: string } {
  const detail = parameter.note ?? '';
  if (parameter.value === null && known.metal === true) return { word: 'not applicable (metal)', tone: 'plain', detail };
  const held = parameter.value !== null && known.held === true;
  if (!held && (!parameter.identifiable || parameter.value === null)) {
    return { word: 'not determined by these data', tone: 'bad', detail };
  }
  // A note beside a value states what fixes it.
  if (held || parameter.std === 0 || detail !== '') return { word: 'fixed', tone: 'plain', detail };
  if (parameter.std === null) return { word: 'determined, without an uncertainty', tone: 'bad', detail };
  return { word: 'yes', tone: 'good', detail };
}

/** What the request and the part say of a parameter of a fit. */
export function knownOf(key: string, fit: Fit, samples: readonly Sample[]): KnownOfParameter {
  const sample = samples.find((s) => s.id === fit.sample_id);
  return {
    held: key in (fit.request?.fix ?? {}),
    metal: sample?.material.kind === 'conductor' && (key === 'rho_d' || key === 'translucency'),
  };
}

export const SCAN_STATES: Readonly<Record<ScanState, { word: string; tone: 'busy' | 'good' | 'warn' | 'bad' | 'plain' }>> = {
  planned: { word: 'planned', tone: 'plain' },
  'waiting-for-operator': { word: 'waiting for you', tone: 'warn' },
  running: { word: 'running', tone: 'busy' },
  pausing: { word: 'pausing', tone: 'busy' },
  paused: { word: 'paused', tone: 'warn' },
  interrupted: { word: 'interrupted', tone: 'warn' },
  completed: { word: 'completed', tone: 'good' },
  aborted: { word: 'aborted', tone: 'plain' },
  failed: { word: 'failed', tone: 'bad' },
};

/** What one job of a kind is called. */
export const JOB_NAMES: Readonly<Record<JobKind, string>> = { fits: 'Fit', maps: 'Map', contrasts: 'Contrast', verdicts: 'Verdict', traces: 'Trace' };

/** States of jobs as chips show them. */
export const JOB_STATES: Readonly<Record<JobState, { readonly word: string; readonly tone: '' | 'good' | 'warn' | 'bad' | 'busy' }>> = {
  running: { word: 'running', tone: 'busy' },
  completed: { word: 'done', tone: 'good' },
  failed: { word: 'failed', tone: 'bad' },
  cancelled: { word: 'cancelled', tone: '' },
  interrupted: { word: 'interrupted', tone: 'warn' },
};

/** The stage of a running job, or its place in the queue. */
export function stageWords(progress: JobProgress | undefined): string {
  const position = progress?.queued_position;
  if (position !== undefined) return position === 1 ? 'waiting, next to start' : `waiting, number ${position} in the queue`;
  return progress?.stage ?? 'starting';
}

/** Whether a scan holds the rig. */
export function isActive(scan: Scan): boolean {
  return ['planned', 'waiting-for-operator', 'running', 'pausing', 'paused'].includes(scan.state);
}

/** Number of frames of the sample so far; the calibration frames come first. */
export function sampleFrames(scan: Scan): number {
  const { plan, progress } = scan;
  if (!progress) return scan.origin === 'import' ? 1 : 0;
  if (scan.origin === 'import' || progress.phase === 'done') return progress.frames_done;
  const poses = plan.poses.length || plan.theta_c_deg.length * plan.phi_s_deg.length;
  const planned = poses * plan.exposures_s.length * plan.repeats;
  // A scan that has not begun states no total.
  const before = Math.max(0, progress.frames_total - planned);
  return Math.max(0, progress.frames_done - before);
}

export const FIT_STATUS: Readonly<Record<string, { word: string; tone: 'good' | 'warn' | 'bad' }>> = {
  converged: { word: 'converged', tone: 'good' },
  'at-bound': { word: 'at a bound', tone: 'warn' },
  'rank-deficient': { word: 'not all parameters determined', tone: 'warn' },
  stalled: { word: 'stalled', tone: 'bad' },
  'not-finite': { word: 'not finite', tone: 'bad' },
  'too-few-observations': { word: 'too few observations', tone: 'bad' },
  cancelled: { word: 'cancelled', tone: 'warn' },
};

/** What to do about a status. */
export const FIT_CURES: Readonly<Record<string, string>> = { 'too-few-observations': 'measure more poses' };

/** State of a fit, or the status of its result, as text. */
export function fitWord(fit: Fit): { word: string; tone: 'good' | 'warn' | 'bad' | 'busy' | 'plain' } {
  if (fit.state === 'running') return { word: 'running', tone: 'busy' };
  if (fit.state === 'failed') return { word: 'failed', tone: 'bad' };
  if (fit.state !== 'completed') return { word: fit.state, tone: 'warn' };
  return FIT_STATUS[fit.status ?? ''] ?? { word: fit.status ?? 'done', tone: 'plain' };
}

/** An axis's warning, `WR: no reference position; home the axis`, split into its code and text. */
export function warningWords(warning: string): { code: string; text: string; serious: boolean } {
  const [, code = '', text = ''] = /^\s*([A-Z]{2})\b:?\s*(.*)$/.exec(warning) ?? [];
  return { code, text: code === '' ? warning : text, serious: code.startsWith('F') || code === 'WL' };
}

export const VARIANTS: Readonly<Record<string, { name: string; meaning: string }>> = {
  auto: { name: 'best', meaning: 'fits paper and sawtooth and compares them by QAIC; takes paper only if it is clearly better' },
  sawtooth: { name: 'sawtooth', meaning: 'exact visibility of the sawtooth, diffuse light from below the surface, double reflections' },
  paper: { name: 'paper', meaning: 'the closed form of Luongo et al. 2017 as printed' },
  traced: { name: 'traced', meaning: 'the sawtooth corrected by ray tracing on the ideal or measured shape; takes seconds to minutes' },
};

export const VERDICTS: Readonly<Record<VerdictWord, { readonly word: string; readonly tone: 'good' | 'warn' | 'bad' }>> = {
  pass: { word: 'pass', tone: 'good' },
  fail: { word: 'fail', tone: 'bad' },
  'cannot-tell': { word: 'cannot tell', tone: 'warn' },
};
