import { describe, expect, it } from 'vitest';

import { ANGLES_MAX, draftOf, isRandom, newScene, readScene, sceneOf, sceneWords, type SceneDraft } from '../../src/lib/sceneform';
import { EXAMPLES, hasRidges, titleOf } from '../../src/lib/scenes';

const faultsOf = (change: Partial<SceneDraft>): unknown => readScene({ ...newScene(), ...change }).faults;

/** Keys and values of a scene without seeds and photons, which do not describe it, and without the wavelength, which has a default. */
const described = (toml: string): string[] =>
  toml.split('\n').map((line) => line.replace(/_(?=\d)/g, '')).filter((line) => line !== '' && !/^(#|seed|photons|wavelength)/.test(line));

describe('the form of a scene', () => {
  it('writes the scene that its fields describe', () => {
    expect(sceneOf(newScene(), 45)).toBe(
      [
        '# Lamp at 45°: ridges of 10° on diffuse body, n 1.5', '', '[light]', 'theta_i_deg = 45.0', 'phi_i_deg = 270.0', 'wavelength_nm = 550.0', '', '[[interface]]', 'shape = "ridges"',
        'theta_r_deg = 10.0', 'pitch_um = 100.0', 'round_um = 2.0', 'alpha_u = 0.1', 'alpha_v = 0.1', 'below = { n = 1.5, rho_d = 0.3 }', '', '[run]', 'photons = 1_000_000', 'seed = 1', '',
      ].join('\n'),
    );
    const layered = sceneOf({ ...newScene(), surface: 'flat', material: 'Au', layer: true, layerN: '1,5', layerK: '1e-4', layerThickness: '20', layerAlpha: '0.2' }, 12.5);
    for (const line of ['theta_i_deg = 12.5', 'below = { n = 1.5, k = 0.0001 }', 'thickness_um = 20.0', 'shape = "flat"\nbelow = "Au"', 'alpha_u = 0.2\nalpha_v = 0.2']) expect(layered).toContain(line);
    expect(titleOf(layered)).toBe('Lamp at 12.5°: rough layer, n 1.5, 20 µm, over flat gold');
    expect(sceneWords({ ...newScene(), surface: 'rough', material: 'conductor', n: '3.1', k: '3.3' })).toBe('rough metal, n 3.1, κ 3.3');
    expect(hasRidges(sceneOf(newScene(), 45))).toBe(true);
  });

  it('writes the examples of the same names', () => {
    for (const { draft, text } of EXAMPLES) {
      if (!draft) continue;
      const { faults, angles } = readScene(draft);
      expect(faults).toEqual({});
      expect(described(sceneOf(draft, angles[0] ?? Number.NaN))).toEqual(described(text));
    }
    expect(EXAMPLES.filter((e) => e.draft === null).map((e) => e.name)).toEqual(['gold-coated sandpaper']);
  });

  it('is filled from a scene that it made, and from no other', () => {
    const drafts: Partial<SceneDraft>[] = [
      {}, { alphaV: '0.2', round: '' }, { alphaU: '' }, { surface: 'rough', material: 'Cr', n: '1.5', rhoD: '' },
      { surface: 'flat', thetaR: '10', alphaU: '', material: 'conductor', n: '3.12', k: '3.33', rhoD: '', round: '' },
      { surface: 'rough', round: '', layer: true, layerN: '1.3', layerK: '0.001', layerThickness: '10', layerAlpha: '0.05', angles: '12.5' },
    ];
    for (const change of drafts) {
      const draft = { ...newScene(), ...change };
      const text = sceneOf(draft, readScene(draft).angles[0] ?? Number.NaN);
      const found = draftOf(text);
      expect(found && sceneOf(found, Number(draft.angles))).toBe(text);
      expect(found?.surface).toBe(draft.surface);
      expect(found?.material).toBe(draft.material);
    }
    expect(draftOf(sceneOf(newScene(), 45).replace('photons = 1_000_000', 'photons = 5'))).toBeNull();
    expect(draftOf(sceneOf(newScene(), 45).replace('theta_r_deg = 10.0', 'theta_r_deg = 12.0'))).toBeNull();
    for (const text of ['', 'nonsense', '[[interface]]\n', ...EXAMPLES.map((e) => e.text)]) expect(draftOf(text)).toBeNull();
  });

  it('names the fault of a field, and ignores fields that the choices do not have', () => {
    expect(faultsOf({})).toEqual({});
    expect(faultsOf({ thetaR: '90', pitch: 'x', round: '-1' })).toEqual({ thetaR: 'Give an angle above 0° and up to 85°.', pitch: '“x” is not a number.', round: 'Give a radius of 0 µm or more, or leave it empty.' });
    expect(faultsOf({ round: '20000' })).toEqual({ round: 'Give a radius from 0 to 10000 µm, or leave it empty.' });
    expect(faultsOf({ alphaU: '', alphaV: '0.1' })).toEqual({ alphaU: 'Give the roughness along the ridges, too.' });
    expect(faultsOf({ surface: 'flat', thetaR: '', alphaU: 'x', rhoD: '' })).toEqual({});
    expect(faultsOf({ material: 'Au', n: '', rhoD: '5', wavelength: '900' })).toEqual({ wavelength: 'Give a wavelength from 365 to 826 nm, which the tables of the metals cover.' });
    // Half of the light stays inside at n 5.8, on its way in and on its way out.
    expect(faultsOf({ n: '5.83', rhoD: '0.3' })).toEqual({ rhoD: 'Give a reflectance from 0 to 0.25, which the boundary lets through, or leave it empty.' });
    expect(faultsOf({ layer: true, layerK: '0.2' })).toEqual({ layerK: 'Give κ from 0 to 0.15, a tenth of n: a layer with a larger κ is opaque, or leave it empty.', layerThickness: 'Give a thickness above 0 µm: the layer absorbs.' });
  });

  it('reads one angle of incidence, a list, or a range', () => {
    const angles = (text: string): unknown => readScene({ ...newScene(), angles: text }).angles;
    expect(angles('40:10:70')).toEqual([40, 50, 60, 70]);
    expect(angles('56,3°')).toEqual([56.3]);
    expect(angles('0, 45')).toEqual([0, 45]);
    expect(faultsOf({ angles: '45, 90' })).toEqual({ angles: '90° is not an angle from 0° to below 90°.' });
    expect(faultsOf({ angles: '' })).toEqual({ angles: 'Give at least one value.' });
    expect(faultsOf({ angles: '0:1:80' })).toEqual({ angles: `81 angles: give at most ${ANGLES_MAX}. Each is a trace.` });
  });

  it('knows whether several surfaces of the same statistics would differ', () => {
    expect([{}, { surface: 'rough' as const }, { layer: true }, { layer: true, layerAlpha: '0.1' }].map((c) => isRandom({ ...newScene(), ...c }))).toEqual([false, true, false, true]);
  });
});
