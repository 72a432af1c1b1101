// What codes, flags and names mean, in words.

import { significant } from './format';
import type { Fit, Parameter, Scan, ScanState } from './types';

export interface ParameterWords {
  /** Symbol as written in text; the part after `_` is set as a subscript. */
  readonly symbol: string;
  readonly name: string;
  readonly unit: string;
}

/** In the order of the table; a parameter that is not listed here is shown under its own name. */
export const PARAMETERS: Readonly<Record<string, ParameterWords>> = {
  theta_r_deg: { symbol: 'θ_r', name: 'ridge angle', unit: '°' },
  alpha_u: { symbol: 'α_u', name: 'roughness along the ridges', unit: '' },
  alpha_v: { symbol: 'α_v', name: 'roughness across the ridges', unit: '' },
  rho_d: { symbol: 'ρ_d', name: 'diffuse reflectance', unit: '' },
  scale: { symbol: 'k', name: 'scale of the signal', unit: '' },
  background: { symbol: 'B', name: 'stray light', unit: '' },
  azimuth_offset_deg: { symbol: 'Δφ_s', name: 'azimuth offset', unit: '°' },
  tilt_offset_deg: { symbol: 'Δθ_c', name: 'tilt offset', unit: '°' },
};

/** What a map and a verdict know beside the parameters. */
export const QUANTITIES: Readonly<Record<string, ParameterWords>> = {
  ...PARAMETERS,
  lean_azimuth_deg: { symbol: 'φ_lean', name: 'azimuth of the lean', unit: '°' },
  chi2_reduced: { symbol: 'χ²', name: 'reduced chi square', unit: '' },
  contrast_mean: { symbol: 'C', name: 'mean contrast after rotation', unit: '' },
  contrast_michelson_mean: { symbol: 'C_M', name: 'mean Michelson contrast', unit: '' },
};

export interface BudgetWords {
  readonly name: string;
  readonly meaning: string;
}

/** In the order of the stacked bars. */
export const BUDGET: Readonly<Record<string, BudgetWords>> = {
  counting: { name: 'counting', meaning: 'shot noise, read noise and the scatter of repeats' },
  reference: { name: 'reference', meaning: 'the white reference’s certificate' },
  angles: { name: 'angles', meaning: 'zeros of the stages and the mounting' },
  material: { name: 'material', meaning: 'the refractive index as stated for the sample' },
  wedge: { name: 'wedge', meaning: 'how the sample lies on the turntable' },
  drift: { name: 'drift', meaning: 'the lamp between the white reference and the sample' },
  background: { name: 'stray light', meaning: 'light that is in all frames but the dark ones' },
  model: { name: 'model', meaning: 'the model’s own inadequacy, estimated from its residuals' },
  tracer: { name: 'ray tracer', meaning: 'standard errors of the traced radiances' },
  shape: { name: 'shape', meaning: 'the measured heights that the tracer worked on' },
  prior: { name: 'known beforehand', meaning: 'what was stated of parameters beside the frames' },
};

/** Parts below this are rounding or nothing to anybody. */
const SHARE_MIN = 1e-6;

/** Parts of a variance as shares of it, in the order of `BUDGET`, unknown ones last. */
export function varianceShares(budget: Readonly<Record<string, number>>): { key: string; std: number; share: number }[] {
  const order = Object.keys(BUDGET);
  const rank = (key: string): number => (order.includes(key) ? order.indexOf(key) : order.length);
  const parts = Object.entries(budget)
    .filter(([, std]) => Number.isFinite(std) && std > 0)
    .sort(([a], [b]) => rank(a) - rank(b));
  const variance = parts.reduce((sum, [, std]) => sum + std * std, 0);
  return parts.map(([key, std]) => ({ key, std, share: (std * std) / variance })).filter((part) => part.share > SHARE_MIN);
}

/** The parts of a budget in one line: `angles 0.021° (24 %), model 0.037° (75 %)`. */
export function budgetSentence(budget: Readonly<Record<string, number>>, unit: string): string {
  return varianceShares(budget)
    .map((p) => `${BUDGET[p.key]?.name ?? p.key} ${significant(p.std)}${unit} (${Math.round(100 * p.share)} %)`)
    .join(', ');
}

/** Whether the data tell a parameter, in words. */
export function identifiability(parameter: Parameter): { word: string; tone: 'good' | 'plain' | 'bad'; detail: string } {
  const detail = parameter.note ?? parameter.reason ?? '';
  // What was held as somebody stated it has its value, and was not asked of the data.
  const held = parameter.value !== null && detail.startsWith('held');
  if (!held && (!parameter.identifiable || parameter.value === null)) {
    return { word: 'not told by these data', tone: 'bad', detail };
  }
  // A note beside a value says by what the parameter is held.
  if (parameter.std === 0 || detail !== '') return { word: 'held fixed', tone: 'plain', detail };
  if (parameter.std === null) return { word: 'told, without an uncertainty', tone: 'bad', detail };
  return { word: 'told by the data', tone: 'good', detail };
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

/** A scan that holds the rig. */
export function isActive(scan: Scan): boolean {
  return ['planned', 'waiting-for-operator', 'running', 'pausing', 'paused'].includes(scan.state);
}

export const FIT_STATUS: Readonly<Record<string, { word: string; tone: 'good' | 'warn' | 'bad' }>> = {
  converged: { word: 'converged', tone: 'good' },
  'at-bound': { word: 'stopped at a bound', tone: 'warn' },
  'rank-deficient': { word: 'not all parameters told', tone: 'warn' },
  stalled: { word: 'stalled', tone: 'bad' },
  'not-finite': { word: 'not finite', tone: 'bad' },
  'too-few-observations': { word: 'too few observations', tone: 'bad' },
  cancelled: { word: 'cancelled', tone: 'warn' },
};

/** State of a fit and status of its result in one word. */
export function fitWord(fit: Fit): { word: string; tone: 'good' | 'warn' | 'bad' | 'busy' | 'plain' } {
  if (fit.state === 'running') return { word: 'running', tone: 'busy' };
  if (fit.state === 'failed') return { word: 'failed', tone: 'bad' };
  if (fit.state !== 'completed') return { word: fit.state, tone: 'warn' };
  return FIT_STATUS[fit.status ?? ''] ?? { word: fit.status ?? 'done', tone: 'plain' };
}

/** An axis's warning as the daemon words it, `WR: no reference position; home the axis`, taken apart. */
export function warningWords(warning: string): { code: string; text: string; serious: boolean } {
  const [, code = '', text = ''] = /^\s*([A-Z]{2})\b:?\s*(.*)$/.exec(warning) ?? [];
  return { code, text: code === '' ? warning : text, serious: code.startsWith('F') || code === 'WL' };
}

export const VARIANTS: Readonly<Record<string, { name: string; meaning: string }>> = {
  auto: { name: 'best', meaning: 'every variant is fitted; the one with the smallest residual is kept' },
  sawtooth: { name: 'sawtooth', meaning: 'exact visibility of the sawtooth, light between facets, diffuse term outside' },
  paper: { name: 'paper', meaning: 'the published closed form as printed' },
  traced: { name: 'traced', meaning: 'the sawtooth corrected by tracing rays on its geometry; takes seconds to minutes' },
};
