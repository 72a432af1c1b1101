// The parts of an uncertainty budget as text and as shares.

import { significant } from './format';

interface BudgetWords {
  readonly name: string;
  readonly meaning: string;
}

/** In the order of the stacked bars. */
export const BUDGET: Readonly<Record<string, BudgetWords>> = {
  counting: { name: 'counting', meaning: 'shot noise, read noise and the scatter of repeats, in frames of the sample and of the white reference' },
  reference: { name: 'reference', meaning: 'the white reference’s certificate' },
  angles: { name: 'angles', meaning: 'zeros, scale and eccentricity of the stages' },
  material: { name: 'material', meaning: 'the stated uncertainty of the refractive index' },
  wedge: { name: 'wedge', meaning: 'tilt of the sample’s mean plane on the turntable, as stated for the rig' },
  drift: { name: 'drift', meaning: 'change of the lamp between white reference and sample' },
  detector: { name: 'detector', meaning: 'the camera’s response curve and exposure times, as determined from exposures of one pose or as stated' },
  background: { name: 'stray light', meaning: 'uncertainty of the light that does not come from the sample' },
  model: { name: 'model', meaning: 'the model error, estimated from the residuals, from leaving out whole tilts and azimuths, and from double reflections' },
  tracer: { name: 'ray tracer', meaning: 'standard errors of the traced radiances' },
  shape: { name: 'shape', meaning: 'curvature of the likelihood, and other minima that the data do not exclude' },
  prior: { name: 'priors', meaning: 'the standard uncertainties of the given priors' },
};

/** Smaller shares are not shown. */
const SHARE_MIN = 1e-6;

/** Parts of a variance as shares of it, in the order of `BUDGET`, others last. */
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
