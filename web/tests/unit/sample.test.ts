import { describe, expect, it } from 'vitest';

import { sampleProblems, sampleRequest, type SampleFields } from '../../src/lib/newsample';
import { sampleWords } from '../../src/lib/sample';
import type { Sample } from '../../src/lib/types';

const fields: SampleFields = { name: ' part 7 ', material: 'dielectric', eta: '1,54', etaStd: '0.02', k: '', kStd: '', metal: 'Cr', wavelength: '' };

describe('a typed part', () => {
  it('is sent with the uncertainty of its index', () => {
    expect(sampleProblems(fields)).toEqual({});
    expect(sampleRequest(fields)).toEqual({ name: 'part 7', material: { kind: 'dielectric', eta: 1.54, eta_std: 0.02 } });
    expect(sampleRequest({ ...fields, material: 'conductor', eta: '3', etaStd: '0', k: '3.3', kStd: '0.1' })).toEqual({ name: 'part 7', material: { kind: 'conductor', eta: 3, eta_std: 0, k: 3.3, k_std: 0.1 } });
    expect(sampleRequest({ ...fields, material: 'metal', wavelength: '633' })).toEqual({ name: 'part 7', metal: { name: 'Cr', wavelength_nm: 633 } });
  });

  it('has faults by field', () => {
    expect(sampleProblems({ ...fields, name: ' ', eta: '' })).toEqual({ name: 'give a name', eta: 'give a number' });
    expect(sampleProblems({ ...fields, eta: '0' }).eta).toBe('must be from 1.0001 to 10');
    expect(sampleProblems({ ...fields, etaStd: '' }).eta).toContain('uncertainty');
    expect(sampleProblems({ ...fields, etaStd: '-1' }).eta).toContain('from 0 to 50');
    // Fields that the chosen material does not have are ignored.
    expect(sampleProblems({ ...fields, k: 'abc' })).toEqual({});
    expect(sampleProblems({ ...fields, material: 'conductor', k: 'abc', kStd: '0' })).toEqual({ k: '“abc” is not a number' });
    expect(sampleProblems({ ...fields, material: 'metal', eta: 'abc', wavelength: '5' })).toEqual({ wavelength: 'must be from 100 to 100000 nm, or empty for the lamp’s wavelength' });
  });

  it('is distinguished from another of its name', () => {
    const sample = (id: number, eta: number): Sample => ({ id, name: 'a', material: { kind: 'dielectric', eta, eta_std: 0.01 }, note: null, simulated: null, earlier_names: [] });
    const [one, two, three] = [sample(1, 1.5), sample(2, 1.6), sample(3, 1.6)];
    expect([one, two, three].map((s) => sampleWords(s, [one, two, three]))).toEqual(['a (n 1.5)', 'a (n 1.6), no. 2', 'a (n 1.6), no. 3']);
  });
});
