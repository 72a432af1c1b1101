import { describe, expect, it } from 'vitest';

import { emptyRows, limitsWords, newRules, riskProblem, rowProblem, rowsOf, rulesOf, specificationOf } from '../../src/lib/limits';
import { typed } from '../../src/lib/typed';

describe('typed', () => {
  it('reads a decimal comma and a true minus sign, and empty text as null', () => {
    expect(typed(' 9,5 ')).toBe(9.5);
    expect(typed('−2')).toBe(-2);
    expect(typed('1e-3')).toBe(0.001);
    expect(typed('')).toBeNull();
  });

  it('refuses a partly typed number', () => {
    for (const text of ['9.5°', 'ten', '1,2,3', '0x10', 'Infinity', '.']) expect(typed(text), text).toBeNaN();
  });
});

describe('a specification', () => {
  const row = (quantity: string, lower: string, upper: string) => ({ quantity, lower, upper });

  it('has the given limits, one side or both', () => {
    const rows = [row('theta_r_deg', '9,5', '10.5'), row('rho_d', '0.25', ''), row('alpha_u', '', '')];
    expect(specificationOf(' drawing 7 ', rows)).toEqual({ name: 'drawing 7', limits: { theta_r_deg: { lower: 9.5, upper: 10.5 }, rho_d: { lower: 0.25 } } });
  });

  it('is null without a limit or with an invalid one', () => {
    expect(specificationOf('x', emptyRows())).toBeNull();
    expect(specificationOf('x', [row('rho_d', '0.25', ''), row('alpha_u', 'a', '')])).toBeNull();
    expect(rowProblem(row('rho_d', '2', '1'))).toBe('the lower limit is above the upper one');
    expect(rowProblem(row('rho_d', '2', '2'))).toBe('the lower and the upper limit are the same');
    expect(specificationOf('x', [row('rho_d', '2', '1')])).toBeNull();
  });

  it('converts back to rows, including quantities that the form does not list', () => {
    const specification = { name: 'x', limits: { theta_r_deg: { lower: 9.5 }, scale: { upper: 2 } } };
    const rows = rowsOf(specification);
    expect(rows.at(-1)).toEqual(row('scale', '', '2'));
    expect(specificationOf('x', rows)).toEqual(specification);
  });

  it('states risks and plane where they differ from the usual ones', () => {
    const rows = [row('theta_r_deg', '9', '11'), row('rho_d', '0.25', '')];
    const limits = { theta_r_deg: { lower: 9, upper: 11 }, rho_d: { lower: 0.25 } };
    expect(specificationOf('x', rows, newRules())).toEqual({ name: 'x', limits });
    const strict = { name: 'x', limits, decision: { max_false_accept_risk: 0.001, max_false_reject_risk: 0.025 }, reference_plane: 'sample' as const };
    expect(specificationOf('x', rows, { accept: '0,1', reject: '2.5', plane: 'sample' })).toEqual(strict);
    expect(rulesOf(strict)).toEqual({ accept: '0.1', reject: '2.5', plane: 'sample' });
    for (const risk of ['0', '50', '', 'x']) expect(riskProblem(risk), risk).not.toBeNull();
    expect(specificationOf('x', rows, { ...newRules(), accept: '50' })).toBeNull();
    expect(limitsWords(strict)).toBe('θr 9 … 11° · ρd ≥ 0.25 · accepted risks 0.1 % (pass), 2.5 % (fail)');
    expect(limitsWords({ name: 'x', limits })).toBe('θr 9 … 11° · ρd ≥ 0.25 · accepted risks 2.5 %');
  });
});
