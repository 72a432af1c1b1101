// Limits and probabilities of a verdict as text.

import { decimalsFor, fixed, significant, withUncertainty } from './format';
import type { VerdictResult } from './types';
import { QUANTITIES } from './words';

type Item = VerdictResult['items'][number];

const number = (x: number | null): string => (x === null ? '' : significant(x, 5).replace(/(\.\d*?)0+$/, '$1').replace(/\.$/, ''));

function range(low: string, high: string): string {
  if (low === '') return high === '' ? '' : `≤ ${high}`;
  return high === '' ? `≥ ${low}` : `${low} … ${high}`;
}

/** The limits of a quantity: `9 … 11°`, `≥ 0.25`. */
export const limitsOf = (item: Item): string => `${range(number(item.lower), number(item.upper))}${QUANTITIES[item.quantity]?.unit ?? ''}`;

/** Values that are accepted, with the decimals of the uncertainty that they contain; empty if there are none. */
export function acceptedWithin({ quantity, acceptance_lower, acceptance_upper, expanded }: Item): string {
  if (acceptance_lower === null && acceptance_upper === null) return '';
  const guarded = (x: number | null): string => (x === null ? '' : expanded === null ? number(x) : fixed(x, Math.min(9, decimalsFor(expanded))));
  return `${range(guarded(acceptance_lower), guarded(acceptance_upper))}${QUANTITIES[quantity]?.unit ?? ''}`;
}

/** A probability, never rounded to 0 or 100 %. */
export function chance(p: number): string {
  if (p > 0.9999) return '> 99.99 %';
  return p < 0.0001 ? '< 0.01 %' : `${(100 * p).toFixed(2)} %`;
}

/** Why a quantity fails, for the head of a result: `ridge angle 10.000°, limits ≥ 12°`. */
export function failureWords(item: Item): string {
  const words = QUANTITIES[item.quantity] ?? { name: item.quantity, unit: '' };
  const value = item.value === null ? '' : ` ${item.expanded === null ? number(item.value) : withUncertainty(item.value, item.expanded).value}${words.unit}`;
  return `${words.name}${value}, limits ${limitsOf(item)}`;
}
