import { describe, expect, it } from 'vitest';

import type { Fit, Parameter, VerdictResult } from '../../src/lib/types';
import { judgedAngle, judgedValuesOf } from '../../src/lib/verdictwords';

type Item = VerdictResult['items'][number];

const item = (quantity: string, value: number | null, std: number | null): Item => ({
  quantity, value, std, expanded: std === null ? null : 2 * std, lower: null, upper: null, acceptance_lower: null, acceptance_upper: null, conformance_probability: null, verdict: 'pass', reason: '',
});
const fitOf = (values: Readonly<Record<string, number | null>>): Pick<Fit, 'id' | 'parameters'> => ({ id: 7, parameters: Object.fromEntries(Object.entries(values).map(([key, value]) => [key, { value } as Parameter])) });

describe('judgedValuesOf', () => {
  it('compares up to a hundredth of the standard uncertainty', () => {
    const verdict = { request: {}, items: [item('theta_r_deg', 10, 0.01), item('contrast_mean', 0.4, 0.01)] };
    expect(judgedValuesOf(verdict, fitOf({ theta_r_deg: 10.00009 }))).toBe(true);
    expect(judgedValuesOf(verdict, fitOf({ theta_r_deg: 10.00011 }))).toBe(false);
    expect(judgedValuesOf(verdict, fitOf({ theta_r_deg: 9 }))).toBe(false);
    // A fit that runs has no values.
    expect(judgedValuesOf(verdict, { id: 7 })).toBe(true);
  });

  it('compares a judged value with one of the fit, and nothing where no value was judged', () => {
    const one = { request: {}, items: [item('rho_d', 0.3, 0.01)] };
    expect(judgedValuesOf(one, fitOf({ rho_d: null }))).toBe(false);
    expect(judgedValuesOf({ request: {}, items: [item('rho_d', 0.3, null)] }, fitOf({ rho_d: 0.3 }))).toBe(true);
    expect(judgedValuesOf({ request: {}, items: [item('rho_d', null, null)] }, fitOf({ rho_d: 0.3 }))).toBe(true);
  });

  it('knows the fit that the verdict rests on', () => {
    const items = [item('theta_r_deg', 10, 0.01)];
    expect(judgedValuesOf({ request: { fit_id: 7 }, items }, fitOf({ theta_r_deg: 12 }))).toBe(true);
    expect(judgedValuesOf({ request: { fit_id: 6 }, items }, fitOf({ theta_r_deg: 12 }))).toBe(false);
  });
});

describe('judgedAngle', () => {
  it('has the decimals of its uncertainty', () => {
    expect(judgedAngle([item('rho_d', 0.3, 0.01), item('theta_r_deg', 10, 0.011)])).toBe('10.000 ± 0.022°');
    expect(judgedAngle([item('rho_d', 0.3, 0.01)])).toBe('');
  });
});
