// Limits and probabilities of a verdict as text.

import { decimalsFor, fixed, significant, withUncertainty } from './format';
import type { Fit, VerdictResult } from './types';
import { QUANTITIES } from './words';

type Item = VerdictResult['items'][number];

/** Share of the standard uncertainty up to which a judged value is that of a fit. */
const ROUNDING = 0.01;

/** Whether a verdict judged the values of a fit: a later fit of the scan may have others. What the fit does not have cannot differ. */
export function judgedValuesOf({ items, request }: Pick<VerdictResult, 'items' | 'request'>, { id, parameters }: Pick<Fit, 'id' | 'parameters'>): boolean {
  if (request.fit_id === id) return true;
  return items.every(({ quantity, value, std }) => {
    const fitted = parameters?.[quantity];
    // An azimuth is judged on the turn of its limits; an item without a value has nothing to compare.
    if (fitted === undefined || value === null || quantity === 'azimuth_offset_deg') return true;
    return fitted.value !== null && Math.abs(value - fitted.value) <= ROUNDING * (std ?? 0);
  });
}

/** The ridge angle that a verdict judged: `10.000 ± 0.022°`; empty without one. */
export function judgedAngle(items: readonly Item[]): string {
  const { value = null, expanded = null } = items.find((item) => item.quantity === 'theta_r_deg') ?? {};
  if (value === null || expanded === null) return '';
  const text = withUncertainty(value, expanded);
  return `${text.value} ± ${text.uncertainty}°`;
}

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
