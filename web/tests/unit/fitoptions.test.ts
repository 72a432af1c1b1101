import { describe, expect, it } from 'vitest';

import { askedWords, knownProblem, optionsOf, type KnownRow } from '../../src/lib/fitoptions';

const row = (parameter: string, value: string, std = ''): KnownRow => ({ parameter, value, std });

describe('optionsOf', () => {
  it('omits defaults', () => {
    expect(optionsOf({ loss: 'linear', judge: false, profile: false, known: [row('rho_d', '', '')] })).toEqual({});
  });

  it('fixes a value without an uncertainty and makes a prior of one with it; reads commas and true minus signs', () => {
    const known = [row('rho_d', '0,3'), row('azimuth_offset_deg', '−1.5', '0,2')];
    expect(optionsOf({ loss: 'huber', judge: true, profile: true, known })).toEqual({
      loss: 'huber', judge: true, profile: true, fix: { rho_d: 0.3 }, priors: { azimuth_offset_deg: { value: -1.5, std: 0.2 } },
    });
  });
});

describe('knownProblem', () => {
  it('reports an invalid number, an invalid uncertainty and a repeated parameter; accepts an empty row', () => {
    const rows = [row('rho_d', '0.3'), row('rho_d', '0.4')];
    expect(rows.map((r) => knownProblem(r, rows))).toEqual(['is given twice', 'is given twice']);
    expect(knownProblem(row('rho_d', ''), [])).toBeNull();
    expect(knownProblem(row('rho_d', 'x'), [])).toMatch(/its value as a number/);
    expect(knownProblem(row('rho_d', '', '0.1'), [])).toMatch(/its value as a number/);
    for (const std of ['0', '-1', 'x']) expect(knownProblem(row('rho_d', '0.3', std), [])).toMatch(/above 0/);
    expect(knownProblem(row('rho_d', '0.3', '0.1'), [])).toBeNull();
  });
});

describe('askedWords', () => {
  it('lists options that are not at their default', () => {
    expect(askedWords({ variant: 'auto', region: null, judge: false, loss: 'linear', fix: {}, priors: {}, starts: null })).toEqual(['model best']);
    expect(askedWords({ variant: 'traced', region: 'even', fix: { rho_d: 0.3 }, priors: { theta_r_deg: { value: 10, std: 0.5 } }, profile: true, shape: { name: 'map.csv' } })).toEqual([
      'model traced', 'region even', 'ρd fixed at 0.3', 'θr known as 10° (u = 0.5°)', 'profile intervals', 'on the shape in map.csv',
    ]);
  });
});
