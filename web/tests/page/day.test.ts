// A day of a technician on the page with a mock daemon: a recipe and a specification, a part, its scan, the verdict, the report, and the
// same part once more.

import { describe, expect, it } from 'vitest';

import { daemon, page, text, url } from './stage';

const form = () => page.getByTestId('next-part');
const start = () => page.getByRole('button', { name: 'Start scan' });

/** Errors of the console in this test. */
function consoleErrors(): string[] {
  const errors: string[] = [];
  page.on('console', (message) => message.type() === 'error' && errors.push(message.text()));
  return errors;
}

async function doSteps(sample: string): Promise<void> {
  for (const step of ['Cap the lens', 'Place the white reference', `Place the part ${sample}`]) {
    await page.getByRole('heading', { name: step }).waitFor();
    await page.getByRole('button', { name: 'Continue' }).click();
  }
}

describe('a technician’s day', () => {
  it('goes from the recipe to the report without leaving the page', async () => {
    const errors = consoleErrors();
    daemon.fitsAtEnd = true;
    await page.goto(url);

    // Before the first part: how it is measured, and what it has to keep.
    await page.getByRole('link', { name: 'Make one in Set-up.' }).click();
    const recipes = page.getByTestId('recipes');
    await recipes.getByRole('button', { name: 'New recipe' }).click();
    const recipe = page.getByTestId('recipe-form');
    await recipe.getByRole('button', { name: 'Save the recipe' }).click();
    await recipe.getByText('Give a name.').waitFor();
    await recipe.getByLabel(/^Name/).fill('PX-1204 rev C');
    await recipe.getByText('custom', { exact: true }).click();
    await recipe.getByLabel(/^Camera tilts/).fill('-20,-10,0,10,20');
    await recipe.getByLabel(/^Sample azimuths/).fill('0°, 90°, 180°');
    await recipe.getByLabel('Exposures, ms', { exact: true }).fill('20 ms, 60 ms');
    await recipe.getByLabel(/^Target/).fill('0,05');
    await recipe.getByRole('combobox', { name: 'Material' }).selectOption('dielectric');
    await recipe.getByLabel(/^n, 1/).fill('1.49');
    await recipe.getByRole('button', { name: 'Save the recipe' }).click();
    await recipes.getByText('5 tilts × 3 azimuths × 2 exposures · target U(θr) ≤ 0.05°').waitFor();
    await page.getByRole('button', { name: 'New specification' }).click();
    const specification = page.getByTestId('specification-form');
    await specification.getByLabel(/^Name/).fill('drawing 4711 B');
    await specification.getByLabel('ridge angle: lower limit').fill('11,5');
    await specification.getByLabel('ridge angle: upper limit').fill('12.5');
    await specification.getByRole('button', { name: 'Save the specification' }).click();
    await page.getByTestId('specifications').getByText('θr 11.5 … 12.5° · accepted risks 2.5 %').waitFor();

    // The part. The only recipe is chosen; the material of a new part is that of the recipe.
    await page.getByRole('navigation', { name: 'Views' }).getByRole('link', { name: 'Measure' }).click();
    await form().getByRole('combobox', { name: /^Part/ }).selectOption({ label: 'New part …' });
    await page.getByTestId('sample-form').getByLabel('Name', { exact: true }).fill('Panel B-17');
    await page.keyboard.press('Enter');
    await expect.poll(() => form().getByRole('combobox', { name: /^Part/ }).locator('option:checked').innerText()).toBe('Panel B-17 (n 1.49)');
    await expect.poll(() => text('[data-testid=recipe-does]')).toBe('5 tilts × 3 azimuths × 2 exposures · target U(θr) ≤ 0.05°');
    expect(await form().getByRole('group', { name: 'Grid of poses' }).count()).toBe(0);
    await form().getByLabel('Specification').selectOption('drawing 4711 B');
    await form().getByLabel('Lot').fill('4');
    await form().getByLabel('External number').fill('A-1001');
    await form().getByLabel('Operator').fill('Ada');
    await page.getByText('You will be asked to: cap the lens').waitFor();
    await start().click();
    await doSteps('Panel B-17');

    // The verdict comes by itself, beside the value.
    const banner = page.getByTestId('verdict-banner');
    await expect.poll(() => banner.innerText()).toMatch(/^PASS\s+drawing 4711 B$/);
    expect(await text('[data-parameter=theta_r_deg]')).toBe('12.031 ± 0.085°');
    expect(await text('[data-testid=purpose]')).toBe('PX-1204 rev C, version 1 · lot 4 · no. A-1001 · measured by Ada');
    const row = page.getByTestId('last-results').locator('tbody tr').first();
    await expect.poll(() => row.innerText()).toMatch(/PASS\s+Panel B-17\s+scan 1 · lot 4 · A-1001\s+12\.031° ± 0\.085°[^]*Report/);
    const opened = page.context().waitForEvent('page');
    await row.getByRole('link', { name: 'Report of scan 1' }).click();
    const report = await opened;
    await report.getByRole('heading', { name: 'Report of scan 1' }).waitFor();
    await report.close();

    // Once more: the form is filled, and nothing starts by itself.
    await page.getByRole('link', { name: 'Open the result' }).click();
    await page.getByRole('button', { name: 'Repeat', exact: true }).click();
    await start().waitFor();
    expect(await form().getByLabel('Recipe').inputValue()).toBe('PX-1204 rev C');
    expect(await form().getByLabel('Specification').inputValue()).toBe('drawing 4711 B');
    expect(await form().getByLabel('Lot').inputValue()).toBe('4');
    expect(daemon.scans).toHaveLength(1);
    await start().click();
    await doSteps('Panel B-17');
    await expect.poll(() => page.getByTestId('last-results').locator('tbody tr').count()).toBe(2);

    // With two scans of the part, Compare opens both.
    await page.getByRole('link', { name: 'Open the result' }).click();
    await page.getByRole('link', { name: 'Compare', exact: true }).click();
    await page.getByTestId('compare').waitFor();
    expect(new URL(page.url()).hash).toBe('#/compare/1,2');

    expect(daemon.requests.filter((r) => r.path === '/scans').map((r) => r.body)).toEqual(
      Array(2).fill({ sample_id: 3, recipe: 'PX-1204 rev C', specification: 'drawing 4711 B', lot: '4', external_id: 'A-1001', operator_name: 'Ada' }),
    );
    expect(errors).toEqual([]);
  });

  it('keeps recipe, specification and operator over a reload, and the own grid folded', async () => {
    for (const name of ['PX-1204', 'PX-1205']) daemon.recipes.add({ name, plan: { preset: 'paper' } });
    daemon.specifications.add({ name: 'drawing 7', limits: { theta_r_deg: { lower: 9 } } });
    await page.goto(url);
    await form().getByRole('combobox', { name: /^Part/ }).selectOption({ label: 'traced polymer (n 1.54)' });
    // Of several recipes none is chosen without a person.
    await form().getByText('Choose the recipe.').waitFor();
    expect(await start().isDisabled()).toBe(true);
    await form().getByLabel('Recipe').selectOption('own grid …');
    await form().getByRole('group', { name: 'Grid of poses' }).waitFor();
    await form().getByLabel('Recipe').selectOption('PX-1205');
    await form().getByLabel('Specification').selectOption('drawing 7');
    await form().getByLabel('Operator').fill('Ada');
    await start().click();
    await page.getByRole('heading', { name: 'Cap the lens' }).waitFor();
    await page.getByRole('button', { name: 'Abort …' }).click();
    await page.getByRole('button', { name: 'Abort for good' }).click();
    await start().waitFor();
    await page.reload();
    await expect.poll(() => form().getByLabel('Recipe').inputValue()).toBe('PX-1205');
    expect(await form().getByLabel('Specification').inputValue()).toBe('drawing 7');
    expect(await form().getByLabel('Operator').inputValue()).toBe('Ada');
    expect(await form().getByLabel('Lot').inputValue()).toBe('');
  });
});

describe('the first scan of a part', () => {
  it('has no earlier one to compare with, so the other one is chosen in the records', async () => {
    daemon.addFit(daemon.addScan(2, 'paper'));
    daemon.addFit(daemon.addScan(1, 'paper'));
    await page.goto(`${url}/#/result/2`);
    await page.getByRole('link', { name: 'Compare', exact: true }).click();
    await page.getByText('Choose another scan.').waitFor();
    expect(await page.getByLabel('Choose scan 2').isChecked()).toBe(true);
    await page.getByLabel('Choose scan 1').check();
    await page.getByRole('link', { name: 'Compare the two' }).waitFor();
  });

  it('is repeated with its own grid where it had no recipe', async () => {
    daemon.addFit(daemon.addScan(1, 'full'));
    await page.goto(`${url}/#/result/1`);
    await page.getByRole('button', { name: 'Repeat', exact: true }).click();
    await expect.poll(() => form().getByLabel(/^Camera tilts/).inputValue()).toBe('-20:5:20');
    expect(await form().getByLabel(/^Sample azimuths/).inputValue()).toBe('0:30:330');
    expect(await form().getByLabel('Exposures, ms').inputValue()).toBe('20, 60, 180');
    expect(await form().getByRole('combobox', { name: /^Part/ }).locator('option:checked').innerText()).toBe('traced polymer (n 1.54)');
  });
});

describe('a verdict that is open', () => {
  it('says what would decide, and another specification is chosen from the library', async () => {
    daemon.specifications.add({ name: 'drawing 7', limits: { theta_r_deg: { lower: 9, upper: 10.1 } } });
    daemon.specifications.add({ name: 'drawing 8', limits: { theta_r_deg: { upper: 9 } }, decision: { max_false_accept_risk: 0.01, max_false_reject_risk: 0.05 } });
    daemon.addFit(daemon.addScan(1, 'paper'));
    await page.goto(`${url}/#/result/1/verdict`);
    const card = page.getByTestId('calculations');
    const judge = card.getByRole('button', { name: 'Judge' });
    expect(await judge.isDisabled()).toBe(true);
    await card.getByLabel('Specification').selectOption('drawing 7');
    await judge.click();
    const banner = page.getByTestId('verdict-banner');
    await expect.poll(() => banner.innerText()).toMatch(/^CANNOT TELL\s+drawing 7\s+12 poses more \(27 in all\) would decide\.$/);
    await card.getByLabel('Specification').selectOption('drawing 8');
    await card.getByText('θr ≤ 9° · accepted risks 1 % (pass), 5 % (fail)').waitFor();
    await judge.click();
    await expect.poll(() => banner.innerText()).toMatch(/^FAIL\s+drawing 8\s+Ridge angle 10\.031°, limits ≤ 9°\.$/);
    // Limits of one occasion, with their risks.
    await card.getByLabel('Specification').selectOption('other limits …');
    await card.getByLabel('ridge angle: upper limit').fill('11');
    await card.getByLabel(/^Risk of passing/).fill('60');
    await card.getByText('give a percentage above 0 and below 50').waitFor();
    expect(await judge.isDisabled()).toBe(true);
    await card.getByLabel(/^Risk of passing/).fill('1');
    await judge.click();
    await expect.poll(() => banner.innerText()).toMatch(/^PASS/);
    expect(daemon.requests.filter((r) => r.path === '/verdicts').map((r) => (r.body as { specification: unknown }).specification)).toEqual([
      'drawing 7',
      'drawing 8',
      // Changed limits do not keep the name of the stored specification.
      { name: 'limits of the page', limits: { theta_r_deg: { upper: 11 } }, decision: { max_false_accept_risk: 0.01, max_false_reject_risk: 0.05 } },
    ]);
  });
});

describe('a verdict on other values', () => {
  it('is muted beside a later fit, in the list too, until that fit is judged', async () => {
    daemon.specifications.add({ name: 'drawing 7', limits: { theta_r_deg: { lower: 9, upper: 11 } } });
    daemon.addFit(daemon.addScan(1, 'paper'));
    await page.goto(`${url}/#/result/1/verdict`);
    const card = page.getByTestId('calculations');
    const judge = card.getByRole('button', { name: 'Judge' });
    const banner = page.getByTestId('verdict-banner');
    await card.getByLabel('Specification').selectOption('drawing 7');
    await judge.click();
    await expect.poll(() => banner.getAttribute('class')).toContain('good');
    await page.getByTestId('fit-form').getByLabel('Model').selectOption('paper');
    await page.getByRole('button', { name: 'Fit again' }).click();
    await expect.poll(() => text('[data-parameter=theta_r_deg]')).toBe('10.61 ± 0.42°');
    expect(await text('[data-testid=verdict-banner]')).toBe('pass for other values drawing 7 The verdict judged another fit: 10.031 ± 0.085°. To judge the values shown here, press Judge in Verdict.');
    expect(await banner.getAttribute('class')).not.toContain('good');
    await page.getByTestId('judged-other').waitFor();
    await page.goto(`${url}/#/measure`);
    const row = page.getByTestId('last-results').locator('tbody tr').first();
    await row.getByText('of other values').waitFor();
    expect(await row.locator('.chip').first().getAttribute('class')).not.toContain('good');

    // The verdict now rests on the fit that is shown.
    await page.goto(`${url}/#/result/1/fit/2/verdict`);
    await judge.click();
    await expect.poll(() => text('[data-testid=verdict-banner]')).toMatch(/^cannot tell drawing 7/i);
    expect(daemon.requests.filter((r) => r.path === '/verdicts').map((r) => r.body)).toEqual([1, 2].map((fit_id) => ({ scan_id: 1, specification: 'drawing 7', fit_id })));
    await page.goto(`${url}/#/result/1/fit/1/verdict`);
    await banner.getByText('for other values').waitFor();
  });
});

describe('recipes and specifications', () => {
  it('change by versions with a history, and are archived and restored', async () => {
    daemon.recipes.add({ name: 'PX-1204', plan: { preset: 'paper', exposures_s: [0.02], repeats: 1 }, fit: { bootstrap: 200, fix: { rho_d: 0.3 } } });
    await page.goto(`${url}/#/setup`);
    const card = page.getByTestId('recipes');
    await card.getByRole('button', { name: 'Change PX-1204' }).click();
    const recipe = page.getByTestId('recipe-form');
    expect(await recipe.getByLabel(/^Name/).isDisabled()).toBe(true);
    expect(await recipe.getByLabel('Known value: value').inputValue()).toBe('0.3');
    await recipe.getByText('Kept from version 1: bootstrap series 200.').waitFor();
    await recipe.getByText('custom', { exact: true }).click();
    await recipe.getByLabel(/^Camera tilts/).fill('0, 75');
    await recipe.getByLabel(/^Repeats/).fill('2');
    await recipe.getByRole('button', { name: 'Save version 2' }).click();
    // The refusal is at its field, which has the focus.
    await recipe.getByText('Camera tilt: 75° is outside −60 to 60°.').waitFor();
    await expect.poll(() => page.evaluate(() => document.activeElement?.closest('label')?.textContent ?? '')).toContain('Camera tilts');
    await recipe.getByLabel(/^Camera tilts/).fill('-10:5:10');
    await recipe.getByLabel(/^Sample azimuths/).fill('0,90');
    await recipe.getByRole('button', { name: 'Save version 2' }).click();
    await card.getByText('5 tilts × 2 azimuths × 1 exposure, 2 frames of each').waitFor();
    expect(daemon.requests.findLast((r) => r.path === '/recipes/1/versions')?.body).toEqual({
      replaces: 1,
      recipe: { name: 'PX-1204', plan: { theta_c_deg: [-10, -5, 0, 5, 10], phi_s_deg: [0, 90], exposures_s: [0.02], repeats: 2 }, fit: { bootstrap: 200, fix: { rho_d: 0.3 } } },
    });
    await card.getByRole('button', { name: 'History of PX-1204' }).click();
    await expect.poll(() => card.getByTestId('history').innerText()).toMatch(/Version 2[^]*repeats: 1 → 2[^]*camera tilts, °: not stated → -10, -5, 0, 5, 10[^]*grid: paper → not stated[^]*Version 1/);
    await card.getByRole('button', { name: 'Archive PX-1204' }).click();
    await card.getByText('None yet.').waitFor();
    await card.getByLabel('archived ones too').check();
    await card.getByRole('button', { name: 'Restore PX-1204' }).click();
    await card.getByRole('button', { name: 'Change PX-1204' }).waitFor();
  });

  it('name the conflict of two changes', async () => {
    daemon.specifications.add({ name: 'drawing 7', limits: { theta_r_deg: { lower: 9 } } });
    await page.goto(`${url}/#/setup`);
    await page.getByRole('button', { name: 'Change drawing 7' }).click();
    daemon.specifications.stored[0]?.versions.push({ content: { name: 'drawing 7', limits: { theta_r_deg: { lower: 9.2 } } }, saved_at: new Date().toISOString() });
    const specification = page.getByTestId('specification-form');
    await specification.getByLabel('ridge angle: upper limit').fill('11');
    await specification.getByRole('button', { name: 'Save version 2' }).click();
    await specification.getByRole('alert').getByText('Version 2 is the newest.').waitFor();
  });
});

it('says where a scan that has no fit is fitted, and that its verdict follows the fit', async () => {
  daemon.specifications.add({ name: 'drawing 7', limits: { theta_r_deg: { lower: 9, upper: 11 } } });
  daemon.addScan(1, 'paper');
  Object.assign(daemon.scans[0]?.body ?? {}, { specification: daemon.specifications.named('drawing 7')?.ref });
  await page.goto(url);
  await page.getByText('Not fitted yet. Open the result and press Fit for the ridge angle and its uncertainty.').waitFor();
  expect(await text('[data-testid=verdict-banner]')).toBe('verdict after the fit drawing 7');
  await page.getByRole('link', { name: 'Open the result' }).click();
  await page.getByText('Not fitted yet. Press Fit for the ridge angle and its uncertainty.').waitFor();
  await page.getByTestId('fit-form').getByRole('button', { name: 'Fit', exact: true }).click();
  await page.getByTestId('verdict-banner').getByText('pass').waitFor();
});
