import { describe, expect, it } from 'vitest';

import { changesBetween, changeWords, refusalsAt } from '../../src/lib/definitions';
import { draftOf, keptWords, recipeFaults, recipeOf, RECIPE_FIELDS } from '../../src/lib/recipe';
import type { Recipe } from '../../src/lib/types';

/** As the daemon sends it: values that are not stated are null. */
const recipe = {
  name: 'PX-1204',
  note: 'quick',
  target_expanded_deg: 0.05,
  plan: {
    preset: null, theta_c_deg: [-20, 0, 20], phi_s_deg: { from: 0, to: 180, step: 90 }, exposures_s: [0.02, 0.06], repeats: 2, dark: { repeats: 4 },
    flat: { theta_c_deg: [0], exposures_s: [0.02], repeats: 2 }, reuse_calibrations: false, reference_every: 20,
  },
  fit: { variant: 'sawtooth', loss: 'huber', profile: true, bootstrap: 200, fix: { rho_d: 0.3 }, priors: { alpha_u: { value: 0.12, std: 0.01 } } },
  material: { eta: 3.1, k: 3.3, eta_std: 0.1, k_std: 0.2 },
  layout: { patches_x: 2, patches_y: 3, patch_size_mm: 5 },
} as unknown as Recipe;

describe('a recipe in its form', () => {
  it('loses nothing: what the form does not show is kept', () => {
    const draft = draftOf(recipe);
    expect(recipeFaults(draft)).toEqual({});
    const { preset: _, ...plan } = recipe.plan;
    expect(recipeOf(draft, recipe)).toEqual({ ...recipe, plan: { ...plan, phi_s_deg: [0, 90, 180] } });
    expect(keptWords(recipe)).toEqual(['2 × 3 patches of 5 mm', 'bootstrap series 200']);
  });

  it('leaves out what is empty, so that the daemon’s defaults apply', () => {
    expect(recipeOf({ ...draftOf(null), name: ' a ' }, null)).toEqual({ name: 'a', plan: { preset: 'paper', repeats: 1 } });
  });

  it('has each fault at its field', () => {
    const wrong = { ...draftOf(null), target: '0', dark: '1.5', flatTilts: '2,5', every: '-1', material: 'conductor' as const, eta: '200', k: '' };
    expect(Object.keys(recipeFaults(wrong)).sort()).toEqual(['material.eta', 'material.k', 'name', 'plan.dark', 'plan.flat.theta_c_deg', 'plan.reference_every', 'target_expanded_deg']);
    expect(recipeOf({ ...wrong, name: 'a' }, null)).toBeNull();
  });
});

describe('two versions', () => {
  it('are compared value by value, in words', () => {
    const later = { ...recipe, note: null, plan: { ...recipe.plan, repeats: 3 }, fit: { ...recipe.fit, fix: {} } };
    expect(changesBetween(recipe, later).map(changeWords)).toEqual(['repeats: 2 → 3', 'note: quick → not stated', 'diffuse reflectance: fixed at: 0.3 → not stated']);
    expect(changesBetween(recipe, recipe)).toEqual([]);
    const specification = { name: 'x', limits: { theta_r_deg: { lower: 9 } } };
    expect(changesBetween(specification, { ...specification, limits: { theta_r_deg: { lower: 9, upper: 11 } } }).map(changeWords)).toEqual(['ridge angle: upper limit: not stated → 11']);
  });
});

describe('a refusal', () => {
  it('is put at its field, also at one that stands for several values', () => {
    const found = refusalsAt(
      [
        { field: 'plan.theta_c_deg[1]', message: 'outside the travel', out_of_range: { value: 75, lower: -60, upper: 60 } },
        { field: 'recipe.material.eta_std', message: 'must not be negative' },
        { field: 'fit.fix.rho_d', message: 'is out of range' },
        { field: 'layout', message: 'the patches overlap' },
      ],
      RECIPE_FIELDS,
    );
    expect(found).toEqual({
      'plan.theta_c_deg': 'Camera tilt: 75° is outside −60 to 60°.',
      'material.eta': 'Must not be negative.',
      'fit.fix': 'Is out of range.',
      '': 'Layout: the patches overlap.',
    });
  });
});
