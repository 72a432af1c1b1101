// The page with a mock daemon: fits, their options and their details.

import { beforeEach, describe, expect, it } from 'vitest';

import { daemon, page, posts, text, url } from './stage';

describe('the fit of another scan in the address', () => {
  it('is said to be one, beside the newest of this scan', async () => {
    daemon.addFit(daemon.addScan(1, 'paper'));
    daemon.addFit(daemon.addScan(2, 'paper'));
    await page.goto(`${url}/#/result/2/fit/1`);
    await page.getByTestId('missing').getByText('Fit 1 is not one of scan 2.').waitFor();
    expect(await page.getByText('Not fitted yet').count()).toBe(0);
    await page.getByRole('link', { name: 'its newest, fit 2' }).click();
    await page.locator('[data-parameter=theta_r_deg]').waitFor();
    expect(await page.getByTestId('missing').count()).toBe(0);
  });

  it('has no words about a model error if the model has none', async () => {
    daemon.addFit(daemon.addScan(1, 'paper'));
    Object.assign(daemon.fits[0] ?? {}, { model_discrepancy: 0 });
    await page.goto(`${url}/#/result/1`);
    await page.getByText('Below each panel the residual').waitFor();
    expect(await page.getByText('the band is the').count()).toBe(0);
  });
});

describe('a fit', () => {
  it('is requested with the model chosen for its own scan', async () => {
    daemon.addScan(1, 'paper');
    const other = daemon.addScan(2, 'paper');
    await page.goto(`${url}/#/result/1`);
    const model = page.getByTestId('fit-form').getByLabel('Model');
    await model.selectOption('traced');
    await page.goto(`${url}/#/result/${other}`);
    await expect.poll(() => model.inputValue()).toBe('auto');
  });

  it('shows which parameter the data do not determine, and the budget of an uncertainty', async () => {
    const scan = daemon.addScan(1, 'full');
    daemon.addFit(scan, 'paper');
    await page.goto(`${url}/#/result/1/uncertainty`);
    const tilt = page.locator('[data-row=tilt_offset_deg]');
    await tilt.waitFor();
    expect(await tilt.innerText()).toContain('not determined by these data');
    expect(await tilt.innerText()).toContain('three azimuths cannot tell it');
    await page.locator('[data-row=theta_r_deg]').getByRole('button').click();
    expect(await text('#budget-theta_r_deg')).toContain('angles 0.021° · 0.99 % of the variance');
  });

  it('lists findings with their share, their effect and what to do', async () => {
    const scan = daemon.addScan(1, 'full');
    daemon.addFit(scan, 'paper');
    daemon.addFit(scan);
    await page.goto(`${url}/#/result/1/fit/2/record`);
    const findings = page.getByTestId('findings');
    await findings.waitFor();
    const shown = await findings.innerText();
    expect(shown).toContain('Translucent body');
    expect(shown).toContain('of χ², moves θr by 0.457°');
    expect(shown).toContain('State sample.translucency');
    // The words of the command line.
    expect(await text('[data-testid=left-out]')).toContain('cone average, effect ≤ 0.0010 % of the peak');
    await page.goto(`${url}/#/result/1/fit/1/record`);
    await expect.poll(() => page.getByTestId('findings').count()).toBe(0);
  });

  it('names the models tried with few digits, and no step that took no time', async () => {
    daemon.addFit(daemon.addScan(1, 'paper'));
    const tried = (variant: string, rms_residual: number): object => ({ variant, status: 'converged', rms_residual, theta_r_deg: 15 });
    Object.assign(daemon.fits[0] ?? {}, { variants: [tried('sawtooth', 1.3e-5), tried('paper', 0.2623)], timing_s: { read: 0, reduce: 0.0011, fit: 5.2 } });
    await page.goto(`${url}/#/result/1/record`);
    await page.getByText('(20000×)').waitFor();
    await page.getByText(/^reduce 0\.0011\d* s, fit 5\.20? s$/).waitFor();
  });

  it('is compared with others, and another one is shown by its link', async () => {
    daemon.addFit(daemon.addScan(1, 'full'), 'paper');
    daemon.addFit(daemon.addScan(2, 'paper'));
    await page.goto(`${url}/#/result/2/fits`);
    await expect.poll(() => text('[data-parameter=theta_r_deg]')).toBe('15.031 ± 0.085°');
    await page.getByLabel('of all scans').check();
    await page.getByTestId('fits').getByRole('link', { name: '1', exact: true }).click();
    await expect.poll(() => text('[data-parameter=theta_r_deg]')).toBe('10.61 ± 0.42°');
    expect(await text('.figures .first dt')).toContain('to the turntable');
    expect(new URL(page.url()).hash).toBe('#/result/1/fit/1/fits');
    await page.getByRole('link', { name: 'Curves' }).click();
    await expect.poll(() => page.getByTestId('curves').locator('figure').count()).toBe(9);
    expect(new URL(page.url()).hash).toBe('#/result/1/fit/1/curves');
  });
});

describe('a store of many fits', () => {
  it('is read page by page, and shows the fit of the address however old it is', async () => {
    daemon.addFit(daemon.addScan(2, 'paper'));
    const scan = daemon.addScan(1, 'paper');
    for (let i = 0; i < 230; i++) daemon.addFit(scan);
    await page.goto(`${url}/#/result/1/fit/1/fits`);
    await expect.poll(() => text('[data-parameter=theta_r_deg]')).toBe('15.031 ± 0.085°');
    expect(await page.getByTestId('missing').count()).toBe(0);
    await page.getByLabel('of all scans').check();
    const rows = page.getByTestId('fits').locator('tbody tr');
    await expect.poll(() => rows.count()).toBe(50);
    expect(await page.getByTestId('fits-count').innerText()).toBe('101 newest fits');
    const older = page.getByRole('button', { name: 'Older fits' });
    for (const n of [100, 150, 200, 231]) {
      await older.click();
      await expect.poll(() => rows.count()).toBe(n);
    }
    expect(await older.count()).toBe(0);
    expect(await page.getByTestId('fits-count').innerText()).toBe('231 fits');
    // Three pages of all fits, and one of the shown scan.
    expect(daemon.reads.filter((path) => path.startsWith('/fits?'))).toHaveLength(4);
  });
});

describe('a fit with few degrees of freedom', () => {
  it('states the coverage factor of each value', async () => {
    for (const scan of [daemon.addScan(1, 'paper'), daemon.addScan(1, 'paper')]) daemon.addFit(scan);
    const parameters = daemon.fits[0]?.['parameters'] as Record<string, { std: number; expanded: number; coverage_factor: number }>;
    const angle = parameters['theta_r_deg'];
    if (angle) Object.assign(angle, { coverage_factor: 4.527, expanded: 4.527 * angle.std });
    await page.goto(`${url}/#/result/2/uncertainty`);
    await expect.poll(() => text('[data-parameter=theta_r_deg]')).toBe('10.03 ± 0.19° k = 4.53');
    expect(await text('[data-parameter=alpha_u]')).toMatch(/ k = 2$/);
    expect(await text('section[aria-labelledby=answer-title] .sum')).toContain('± is the expanded uncertainty, k = 2 … 4.53 ·');
    const table = page.getByTestId('parameters');
    await expect.poll(() => table.getByRole('columnheader', { name: 'U (k = 2 … 4.53)' }).count()).toBe(1);
    expect((await table.locator('[data-row=theta_r_deg] td').nth(1).innerText()).replace(/\s+/g, ' ')).toBe('± 0.19° k = 4.53');
    // The other scan has one factor, which is stated once.
    await page.goto(`${url}/#/result/1/uncertainty`);
    await expect.poll(() => text('[data-parameter=theta_r_deg]')).toBe('10.031 ± 0.085°');
    await expect.poll(() => table.getByRole('columnheader', { name: 'U (k = 2)' }).count()).toBe(1);
    await page.goto(`${url}/#/measure`);
    const last = page.getByTestId('last-results');
    await last.getByRole('columnheader', { name: 'θr ± U (k = 2 … 4.53)' }).waitFor();
    expect((await last.locator('tbody tr').first().locator('.number').innerText()).replace(/\s+/g, ' ')).toBe('10.03° ± 0.19° k = 4.53');
    await page.goto(`${url}/#/compare/1,2`);
    await page.getByText('± is U (k = 2 … 4.53)').waitFor();
  });
});

describe('the head of a result', () => {
  it('counts the warnings beside the status, and leads to them', async () => {
    daemon.addFit(daemon.addScan(1, 'paper'));
    Object.assign(daemon.fits[0] ?? {}, { warnings: ['manifest.toml line 9 has no effect', 'set `rig.sample_wedge_std_deg` to `0.02`'] });
    await page.goto(`${url}/#/measure`);
    await page.locator('section[aria-labelledby=answer-title]').getByRole('link', { name: '2 warnings' }).click();
    const listed = page.locator('.warnings li');
    await listed.first().waitFor();
    // Files keep their case, and codes have no backticks.
    expect(await listed.allInnerTexts()).toEqual(['manifest.toml line 9 has no effect.', 'Set rig.sample_wedge_std_deg to 0.02.']);
    expect(await listed.locator('code').allInnerTexts()).toEqual(['rig.sample_wedge_std_deg', '0.02']);
    Object.assign(daemon.fits[0] ?? {}, { warnings: [] });
    await page.goto(`${url}/#/result/1/curves`);
    await page.reload();
    await page.getByText('converged', { exact: true }).first().waitFor();
    expect(await page.getByRole('link', { name: /warning/ }).count()).toBe(0);
  });

  it('calls a value that was held fixed, with the digits that were typed', async () => {
    daemon.addFit(daemon.addScan(1, 'paper'));
    const parameters = daemon.fits[0]?.['parameters'] as Record<string, unknown>;
    parameters['theta_r_deg'] = { value: 12.000000000000002, std: null, expanded: null, coverage_factor: null, identifiable: false, budget: null, note: 'held at the stated value' };
    await page.goto(`${url}/#/result/1/fits`);
    await expect.poll(() => text('[data-parameter=theta_r_deg]')).toBe('12° (fixed)');
    await expect.poll(() => page.getByTestId('fits').locator('tbody td').nth(3).innerText()).toBe('12 (fixed)');
    await page.goto(`${url}/#/measure`);
    const row = page.getByTestId('last-results').locator('tbody tr').first();
    await expect.poll(() => row.locator('.number').innerText()).toBe('12° (fixed)');
    expect(await row.locator('.dot').count()).toBe(0);
  });

  it('is in the list of the last results also without an angle, with what to do', async () => {
    daemon.addFit(daemon.addScan(1, 'paper'));
    const none = { value: null, std: null, expanded: null, coverage_factor: null, identifiable: false, budget: null };
    Object.assign(daemon.fits[0] ?? {}, { status: 'too-few-observations', parameters: { theta_r_deg: none } });
    await page.goto(`${url}/#/measure`);
    const row = page.getByTestId('last-results').locator('tbody tr').first();
    await expect.poll(async () => (await row.locator('.number').innerText()).replace(/\s+/g, ' ')).toBe('too few observations measure more poses');
  });
});

describe('the last results', () => {
  it('have an axis with its two ends', async () => {
    daemon.addFit(daemon.addScan(1, 'paper'));
    const angle = (daemon.fits[0]?.['parameters'] as Record<string, object>)['theta_r_deg'];
    Object.assign(angle ?? {}, { value: 10, std: 0.01, expanded: 0.02 });
    await page.goto(url);
    await page.getByTestId('last-results').waitFor();
    await expect.poll(() => page.getByTestId('last-results').locator('th.forest span').allTextContents()).toEqual(['9.96°', '10.04°']);
  });
});

describe('the list of fits', () => {
  it('has an axis with two different ends, and on a phone nothing over the ridge angle', async () => {
    daemon.addFit(daemon.addScan(1, 'paper'));
    const angle = (daemon.fits[0]?.['parameters'] as Record<string, object>)['theta_r_deg'];
    Object.assign(angle ?? {}, { value: 10, std: 0.01, expanded: 0.02 });
    await page.setViewportSize({ width: 390, height: 844 });
    await page.goto(`${url}/#/result/1/fits`);
    const fits = page.getByTestId('fits');
    await expect.poll(() => fits.locator('th.forest span').allTextContents()).toEqual(['9.96°', '10.04°']);
    for (const everything of [false, true]) {
      await page.getByLabel('of all scans').setChecked(everything);
      const [value, state] = await Promise.all([fits.locator('tbody td').nth(3).boundingBox(), fits.locator('tbody td').last().boundingBox()]);
      expect(state?.x ?? 0).toBeGreaterThanOrEqual((value?.x ?? 1e9) + (value?.width ?? 0));
    }
  });
});

describe('the list of fits on half a screen', () => {
  it('leaves the common axis out, whose ends would overlap, and separates the status from the number that it covers', async () => {
    daemon.addFit(daemon.addScan(1, 'paper'));
    await page.goto(`${url}/#/result/1/fits`);
    const axis = page.getByTestId('fits').locator('th.forest');
    await axis.waitFor();
    await page.setViewportSize({ width: 720, height: 900 });
    await axis.waitFor({ state: 'hidden' });
    const status = page.getByTestId('fits').locator('tbody td').last();
    expect(await status.evaluate((cell) => [getComputedStyle(cell).boxShadow === 'none', getComputedStyle(cell).backgroundImage])).toEqual([false, 'none']);
    // On a phone no number is cut.
    await page.setViewportSize({ width: 360, height: 800 });
    await expect.poll(() => status.evaluate((cell) => { const list = cell.closest('.list'); return (list?.scrollWidth ?? 1e9) - (list?.clientWidth ?? 0); })).toBe(0);
  });
});

describe('the answer', () => {
  it('has its values on one line, however many lines their names take', async () => {
    daemon.addFit(daemon.addScan(1, 'paper'));
    const parameters = daemon.fits[0]?.['parameters'] as Record<string, object>;
    for (const [name, expanded] of [['alpha_u', 0.0004], ['alpha_v', 0.00042], ['rho_d', 0.0054]] as const) Object.assign(parameters[name] ?? {}, { expanded, std: expanded / 2, coverage_factor: 2.07 });
    for (const [width, view] of [[1440, 'measure'], [794, 'result/1'], [700, 'result/1']] as const) {
      await page.setViewportSize({ width, height: 900 });
      await page.goto(`${url}/#/${view}`);
      const value = (name: string): Promise<number> => page.locator(`[data-parameter=${name}] .value`).evaluate((element) => element.getBoundingClientRect().bottom);
      await page.locator('[data-parameter=rho_d]').waitFor();
      const bottoms = await Promise.all(['alpha_u', 'alpha_v', 'rho_d'].map(value));
      expect(Math.max(...bottoms) - Math.min(...bottoms), `${view} at ${width} pixels: ${bottoms.join(', ')}`).toBeLessThan(1);
    }
  });
});

describe('the fit of a metal', () => {
  it('has no diffuse reflectance, which is not a fault', async () => {
    daemon.addFit(daemon.addScan(1, 'paper'));
    const parameters = daemon.fits[0]?.['parameters'] as Record<string, unknown>;
    Object.assign(daemon.samples.find((s) => s['id'] === 1) ?? {}, { material: { kind: 'conductor', eta: 0.35, eta_std: 0.01, k: 2.7, k_std: 0.01 } });
    parameters['rho_d'] = { value: null, std: null, expanded: null, coverage_factor: null, identifiable: false, budget: null, note: 'a metal returns no light from below its surface, so it has no ρd' };
    await page.goto(`${url}/#/result`);
    const place = page.locator('[data-parameter=rho_d] span');
    await place.waitFor();
    expect(await place.innerText()).toBe('not applicable (metal)');
    expect(await place.getAttribute('class')).not.toContain('bad');
  });
});

describe('the uncertainty along a scan', () => {
  const row = (id: number) => ({ id, elapsed_s: 9 * id, n_observations: id, n_frames_used: id, variant: 'sawtooth', status: 'converged', parameters: { theta_r_deg: { value: 10, std: 0.3 / id } } });

  it.each([[1, 0], [2, 1]])('of %i fits and the last one is drawn as %i plots, in words always', async (fits, plots) => {
    for (let id = 1; id <= fits; id++) daemon.certainties.push(row(id));
    daemon.addFit(daemon.addScan(1, 'paper'));
    await page.goto(`${url}/#/result/1/uncertainty`);
    const card = page.getByTestId('certainty');
    await card.waitFor();
    expect(await card.locator('[data-line=theta_r_deg]').innerText()).toMatch(/10\.031 ± 0\.085°/);
    await expect.poll(() => card.locator('canvas').count()).toBe(plots);
    expect(await card.innerText()).toMatch(/After \d+ s of the rig’s time: 15 poses/);
  });
});

describe('error against run time', () => {
  const point = (method: string, seconds: number, error: number, scene = 'n = 1.5 (flat) on n = 2.4 (flat) at 60°') => ({
    scene, method, seconds, error, quantity: 'relative error of the reflected energy', reference: 'exact (flat layers)',
  });

  it('shows a line per method, its slope, the reference and what plans leave out', async () => {
    daemon.accuracy = {
      machine: 'ridged, two threads', written_at: '2026-01-02T03:04:05Z',
      points: [point('split', 0.01, 1e-2), point('split', 0.1, 3.16e-3), point('split', 1, 1e-3), point('analog', 0.1, 2e-2), point('scalar', 0.01, 1.5e-2), point('scalar', 0.1, 1.6e-2), point('scalar', 1, 1.7e-2), point('quadrature', 0.2, 1e-4, 'series')],
      forecasts: [{ scene: 'flat', forecast_s: 1, taken_s: 1.5 }, { scene: 'rough', forecast_s: 1, taken_s: 3 }],
      proofs: [{ scene: 'flat', off: 0.002, allowed: 0.011, holds: true, full_s: 0.3, planned_s: 0.1, parts: [{ what: 'polarisation of light', speed_up: 2.9 }] }],
    };
    await page.goto(`${url}/#/lab`);
    const view = page.getByTestId('accuracy');
    await view.waitFor();
    await expect.poll(() => view.locator('g[data-method]').count()).toBe(3);
    await expect.poll(() => view.locator('g[data-method=split] circle').count()).toBe(3);
    expect(await view.locator('text[data-axis=y]').textContent()).toBe('relative error');
    const words = await view.innerText();
    for (const part of ['slope −0.50', 'levels off', 'exact (flat layers)', '1 of 1 within', 'factor of 2: 1 of 2', 'ridged, two threads']) expect(words).toContain(part);
    await view.locator('summary').click();
    expect(await view.getByTestId('proofs').innerText()).toContain('polarisation of light');
    await view.getByRole('combobox', { name: 'Scene' }).selectOption('series');
    await expect.poll(() => view.locator('g[data-method]').count()).toBe(1);
  });

  it('is not shown without a measurement', async () => {
    await page.goto(`${url}/#/lab`);
    await page.getByTestId('traces').waitFor();
    expect(await page.getByTestId('accuracy').count()).toBe(0);
  });
});

describe('the options of a fit', () => {
  const sent = (): unknown => daemon.requests.findLast((r) => r.path === '/fits' && r.method === 'POST')?.body;

  it('are sent as chosen, and the result lists them', async () => {
    daemon.addScan(1, 'paper');
    await page.goto(`${url}/#/result`);
    const form = page.getByTestId('fit-form');
    const fit = form.getByRole('button', { name: 'Fit', exact: true });
    await form.getByRole('button', { name: 'Options' }).click();
    await form.getByLabel('Profile intervals').check();
    await form.getByLabel('Outliers').selectOption('huber');
    const known = form.getByRole('button', { name: 'Add a known value' });
    await known.click();
    await known.click();
    await form.getByLabel('Known value: parameter').first().selectOption('rho_d');
    await form.getByLabel('Known value: parameter').nth(1).selectOption('theta_r_deg');
    await form.getByLabel('Known value: value').first().fill('0,3');
    await form.getByLabel('Known value: value').nth(1).fill('ten');
    await form.getByRole('alert').filter({ hasText: 'The ridge angle: give its value as a number.' }).waitFor();
    expect(await fit.isDisabled()).toBe(true);
    await form.getByLabel('Known value: value').nth(1).fill('10');
    await form.getByLabel('Known value: standard uncertainty').nth(1).fill('0.5');
    await fit.click();
    await expect.poll(sent).toEqual({ scan_id: 1, variant: 'auto', loss: 'huber', profile: true, fix: { rho_d: 0.3 }, priors: { theta_r_deg: { value: 10, std: 0.5 } } });
    await page.getByRole('link', { name: 'Record', exact: true }).click();
    await expect.poll(() => text('[data-testid=asked]')).toBe('model best, outliers count less (Huber), ρd fixed at 0.3, θr known as 10° (u = 0.5°), profile intervals');
  });

  it('are refused beside the options', async () => {
    daemon.addScan(1, 'paper');
    daemon.refusals.set('POST /fits', { status: 422, body: { code: 'invalid-value', title: 'a value is not valid', detail: 'fix.rho_d: lies between 0 and 1', errors: [{ field: 'fix.rho_d', message: 'lies between 0 and 1' }] } });
    await page.goto(`${url}/#/result`);
    const form = page.getByTestId('fit-form');
    await form.getByRole('button', { name: 'Options' }).click();
    await form.getByRole('button', { name: 'Add a known value' }).click();
    await form.getByLabel('Known value: parameter').selectOption('rho_d');
    await form.getByLabel('Known value: value').fill('3');
    await form.getByRole('button', { name: 'Fit', exact: true }).click();
    await form.getByRole('alert').filter({ hasText: 'Diffuse reflectance: lies between 0 and 1.' }).waitFor();
  });
});

describe('a recorded series', () => {
  it('is imported from its folder and shown', async () => {
    await page.goto(`${url}/#/records`);
    await page.getByText('Import a series').click();
    await page.getByLabel('Folder on the measuring PC').fill('/data/seven');
    await page.getByRole('button', { name: 'Import' }).click();
    await page.getByText('Scan 1 with 48 frames; left out: frames/7.png.').waitFor();
    await page.getByRole('link', { name: 'Open scan 1' }).click();
    expect(daemon.requests.find((r) => r.path === '/imports')?.body).toEqual({ folder: '/data/seven', skip_unreadable: false });
    await page.locator('#answer-title').waitFor();
  });

  it('is imported from a zip archive of this computer', async () => {
    await page.goto(`${url}/#/records`);
    await page.getByText('Import a series').click();
    await page.getByLabel('Zip archive of the series').setInputFiles({ name: 'seven.zip', mimeType: 'application/zip', buffer: Buffer.from('PK') });
    await page.getByLabel('Folder on the measuring PC').waitFor({ state: 'detached' });
    await page.getByRole('button', { name: 'Import' }).click();
    await page.getByText('Scan 1 with 48 frames; left out: frames/7.png.').waitFor();
    expect(daemon.requests.find((r) => r.path === '/imports/upload')?.body).toEqual({ archive: 'PK' });

    daemon.refusals.set('POST /imports/upload', { status: 422, body: { code: 'series-invalid', title: 'a value is not valid', detail: 'seven.zip: it contains no manifest.toml; pack the folder' } });
    await page.getByRole('button', { name: 'Import' }).click();
    await page.getByRole('alert').filter({ hasText: 'it contains no manifest.toml' }).waitFor();
  });

  it('reports beside the folder what is wrong and what to do', async () => {
    daemon.refusals.set('POST /imports', { status: 422, body: { code: 'frame-unreadable', title: 'a value is not valid', detail: 'frames/7.png is torn; nothing was imported' } });
    await page.goto(`${url}/#/records`);
    await page.getByText('Import a series').click();
    await page.getByLabel('Folder on the measuring PC').fill('/data/seven');
    await page.getByRole('button', { name: 'Import' }).click();
    await page.getByRole('alert').filter({ hasText: 'tick “leave out frames that cannot be read”.' }).waitFor();
  });
});

describe('a fit on a measured shape', () => {
  const heights = Buffer.from('0,1,2\n0,1,2\n');
  const map = { name: 'map.csv', mimeType: 'text/csv', buffer: heights };
  const sent = (): unknown => daemon.requests.findLast((r) => r.path === '/fits' && r.method === 'POST')?.body;

  beforeEach(async () => {
    daemon.addScan(1, 'paper');
    await page.goto(`${url}/#/result`);
    await page.getByTestId('fit-form').getByLabel('Model').selectOption('traced');
  });

  it('sends the file with its units, and the result states the traced shape', async () => {
    const form = page.getByTestId('fit-form');
    await form.getByLabel('Height file').setInputFiles(map);
    await form.getByLabel('Sample spacing, µm').fill('0,5');
    await form.getByLabel('Height unit, µm').fill('0,001');
    await form.getByRole('button', { name: 'Fit', exact: true }).click();
    await expect.poll(sent).toEqual({ scan_id: 1, variant: 'traced', shape: { name: 'map.csv', content: heights.toString('base64'), pitch_um: 0.5, height_unit_um: 0.001 } });
    await page.getByRole('link', { name: 'Record', exact: true }).click();
    await expect.poll(() => text('[data-testid=traced-on]')).toBe('a height map of 6 ridges, 102 µm apart, θr 9.998° by its heights');
  });

  it('reports beside the file why the daemon refused it, and fits without it', async () => {
    daemon.refusals.set('POST /fits', { status: 422, body: { code: 'invalid-value', title: 'a value is not valid', detail: 'shape: map.csv: the file does not state the spacing of its samples: add --pitch-um (pitch_um)', errors: [{ field: 'shape', message: 'map.csv: the file does not state the spacing of its samples: add --pitch-um (pitch_um)' }] } });
    const form = page.getByTestId('fit-form');
    await form.getByLabel('Height file').setInputFiles(map);
    await form.getByRole('button', { name: 'Fit', exact: true }).click();
    await form.getByRole('alert').filter({ hasText: 'Shape: map.csv: the file does not state the spacing of its samples' }).waitFor();
    daemon.refusals.clear();
    await form.getByRole('button', { name: 'Remove' }).click();
    expect(await form.getByRole('alert').count()).toBe(0);
    await form.getByRole('button', { name: 'Fit', exact: true }).click();
    await expect.poll(sent).toEqual({ scan_id: 1, variant: 'traced' });
    await page.getByRole('link', { name: 'Record', exact: true }).click();
    await expect.poll(() => text('[data-testid=traced-on]')).toBe('an ideal sawtooth');
  });

  it('does not send a file that is too large or of another kind, invalid units, or a shape with another model', async () => {
    const form = page.getByTestId('fit-form');
    const fit = form.getByRole('button', { name: 'Fit', exact: true });
    const file = form.getByLabel('Height file');
    await file.setInputFiles({ ...map, name: 'map.tif', buffer: Buffer.alloc(7_000_000) });
    await form.getByRole('alert').filter({ hasText: 'map.tif has 7.0 MB; a request may have 6.2 MB' }).waitFor();
    expect(await fit.isDisabled()).toBe(true);
    await file.setInputFiles({ ...map, name: 'map.docx' });
    await form.getByRole('alert').filter({ hasText: 'Supported extensions: .csv' }).waitFor();
    await file.setInputFiles(map);
    await form.getByLabel('Sample spacing, µm').fill('0');
    await form.getByText('give one length above 0').waitFor();
    expect(await fit.isDisabled()).toBe(true);
    expect(posts()).toEqual([]);
    await form.getByLabel('Model').selectOption('auto');
    expect(await file.count()).toBe(0);
    await fit.click();
    await expect.poll(sent).toEqual({ scan_id: 1, variant: 'auto' });
  });

  it('does not carry the shape of one part over to another', async () => {
    const other = daemon.addScan(2, 'paper');
    await page.goto(`${url}/#/result/1`);
    await page.reload();
    const form = page.getByTestId('fit-form');
    await form.getByLabel('Model').selectOption('traced');
    await form.getByLabel('Height file').setInputFiles(map);
    await form.getByLabel('Sample spacing, µm').waitFor();
    await page.goto(`${url}/#/result/${other}`);
    await form.getByLabel('Sample spacing, µm').waitFor({ state: 'detached' });
    await form.getByLabel('Model').selectOption('traced');
    expect(await form.getByLabel('Height file').inputValue()).toBe('');
  });
});

describe('a fit that runs', () => {
  it('shows its stage and the time left, and can be cancelled', async () => {
    daemon.addScan(1, 'paper');
    daemon.fitMs = null;
    await page.goto(`${url}/#/result`);
    await page.getByRole('button', { name: 'Fit', exact: true }).click();
    await page.getByText('Fit 1: tracing, 42 s left').waitFor();
    await page.getByText('Forecast: about 50 s for 108 poses').waitFor();
    await page.getByRole('button', { name: 'Cancel' }).click();
    await page.getByText('Fit 1 was cancelled and has no result.').waitFor();
    expect(daemon.requests.map((r) => r.path)).toContain('/fits/1/cancel');
    expect(await page.getByTestId('fit-form').getByRole('button', { name: 'Fit again' }).isEnabled()).toBe(true);
  });
});
