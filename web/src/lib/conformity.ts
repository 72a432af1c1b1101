// Conformity with tolerance limits as the daemon judges it (src/judge): JCGM 106:2012, guarded acceptance, for a value whose
// error is normally distributed.

import { normalBelow } from './normal';
import type { LimitPair, Specification, VerdictWord } from './types';

export interface Risks {
  /** Largest allowed probability that what passes does not conform. */
  readonly accept: number;
  /** Largest allowed probability that what fails conforms. */
  readonly reject: number;
}

const USUAL = 0.025;
/** Standard uncertainties from which on a probability differs from 0 or 1 by less than 1e-18. */
const CERTAIN = 9;

export const risksOf = (specification: Specification | null): Risks => ({
  accept: specification?.decision?.max_false_accept_risk ?? USUAL,
  reject: specification?.decision?.max_false_reject_risk ?? USUAL,
});

/** Probability that the true value is within the limits; `std` is the standard uncertainty (k = 1). */
export function conformance(value: number, std: number, { lower, upper }: LimitPair): number {
  /** Probability that the true value is outside a limit that the measured value is inside of by this distance. */
  const beyond = (distance: number): number => (Math.abs(distance) >= CERTAIN * std ? (distance < 0 ? 1 : 0) : normalBelow(-distance / std));
  return Math.max(0, 1 - (lower == null ? 0 : beyond(value - lower)) - (upper == null ? 0 : beyond(upper - value)));
}

export function judged(value: number, std: number, limits: LimitPair, risks: Risks): VerdictWord {
  const probability = conformance(value, std, limits);
  if (1 - probability <= risks.accept) return 'pass';
  return probability <= risks.reject ? 'fail' : 'cannot-tell';
}
