import { describe, expect, it } from 'vitest';

import { askedWords, knownProblem, optionsOf, refusedWords, type KnownRow } from '../../src/lib/fitoptions';

const row = (parameter: string, value: string, std = ''): KnownRow => ({ parameter, value, std });

describe('optionsOf', () => {
  it('sends nothing that stands at its default', () => {
    expect(optionsOf({ loss: 'linear', judge: false, profile: false, known: [row('rho_d', '', '')] })).toEqual({});
  });

  it('holds a value without an uncertainty and states one with it, commas and true minus signs included', () => {
    const known = [row('rho_d', '0,3'), row('azimuth_offset_deg', '−1.5', '0,2')];
    expect(optionsOf({ loss: 'huber', judge: true, profile: true, known })).toEqual({
      loss: 'huber', judge: true, profile: true, fix: { rho_d: 0.3 }, priors: { azimuth_offset_deg: { value: -1.5, std: 0.2 } },
    });
  });
});

describe('knownProblem', () => {
  it('names what is no number, no uncertainty, or there twice; an empty row is none', () => {
    const rows = [row('rho_d', '0.3'), row('rho_d', '0.4')];
    expect(rows.map((r) => knownProblem(r, rows))).toEqual(['is there twice', 'is there twice']);
    expect(knownProblem(row('rho_d', ''), [])).toBeNull();
    expect(knownProblem(row('rho_d', 'x'), [])).toMatch(/its value as a number/);
    expect(knownProblem(row('rho_d', '', '0.1'), [])).toMatch(/its value as a number/);
    for (const std of ['0', '-1', 'x']) expect(knownProblem(row('rho_d', '0.3', std), [])).toMatch(/above 0/);
    expect(knownProblem(row('rho_d', '0.3', '0.1'), [])).toBeNull();
  });
});

describe('refusedWords', () => {
  it('calls parameters as the form does', () => {
    expect(refusedWords('Fix.rho_d: rho_d is out of range; give a value from 0 to 1.')).toBe('The diffuse reflectance is out of range; give a value from 0 to 1.');
    expect(refusedWords('Fix: k is the extinction coefficient of a metal.')).toBe('K is the extinction coefficient of a metal.');
    expect(refusedWords('Priors.new: there is none.')).toBe('The new: there is none.');
  });
});

describe('askedWords', () => {
  it('says what was asked and not what stands at its default', () => {
    expect(askedWords({ variant: 'auto', region: null, judge: false, loss: 'linear', fix: {}, priors: {}, starts: null })).toEqual(['model best']);
    expect(askedWords({ variant: 'traced', region: 'even', fix: { rho_d: 0.3 }, priors: { theta_r_deg: { value: 10, std: 0.5 } }, profile: true, shape: { name: 'map.csv' } })).toEqual([
      'model traced', 'region even', 'ρd held at 0.3', 'θr known as 10 ± 0.5°', 'profile intervals', 'on the shape in map.csv',
    ]);
  });
});
