// The form of the next scan, and its part.

import { describe, expect, it } from 'vitest';

import { chooseSample, daemon, page, posts, text, url } from './stage';

describe('the form of a new scan', () => {
  const plan = (): unknown => (daemon.requests.findLast((r) => r.path === '/scans')?.body as { plan?: unknown } | undefined)?.plan;
  const start = () => page.getByRole('button', { name: 'Start scan' });

  it('can be started only with an estimate, whose text moves the button', async () => {
    let answer = (): void => undefined;
    const held = new Promise<void>((go) => (answer = () => go()));
    await page.route('**/scans/estimate', async (route) => {
      await held;
      await route.continue();
    });
    await page.goto(url);
    await chooseSample();
    await start().waitFor();
    expect(await start().isDisabled()).toBe(true);
    answer();
    // As slow as a user.
    await start().click({ delay: 150 });
    await expect.poll(plan).toEqual({ preset: 'paper', repeats: 1 });
  });

  it('warns of a grid with too few poses for a fit', async () => {
    await page.goto(url);
    await chooseSample();
    await page.getByText('53 frames').waitFor();
    expect(await page.getByTestId('few-poses').count()).toBe(0);
    await page.getByText('custom', { exact: true }).click();
    await page.getByLabel(/Camera tilts/).fill('0');
    await page.getByLabel(/Sample azimuths/).fill('0, 90');
    await expect.poll(() => page.getByTestId('few-poses').innerText()).toBe('2 poses are too few: a fit needs at least 9 poses.');
    // A scan of few poses may have another purpose.
    await expect.poll(() => start().isDisabled()).toBe(false);
  });

  it('does not misread a decimal comma, and shows what it read', async () => {
    await page.goto(url);
    await chooseSample();
    await page.getByText('53 frames').waitFor();
    await page.getByLabel('Repeats').fill('1,5');
    await page.getByText('Give a whole number from 1 to 100.').waitFor();
    expect(await start().isDisabled()).toBe(true);
    await page.getByLabel('Repeats').fill('2');
    await page.getByLabel('Exposures, ms').fill('2,5');
    await page.getByText('“2,5” is ambiguous').waitFor();
    expect(await start().isDisabled()).toBe(true);
    await page.getByLabel('Exposures, ms').fill('2, 5');
    await expect.poll(() => text('[data-testid=readings]')).toBe('2 exposures: 2 ms, 5 ms');
    await start().click();
    await expect.poll(plan).toEqual({ preset: 'paper', repeats: 2, exposures_s: [0.002, 0.005] });
  });

  it('names the calibrations that it would reuse, and takes new ones if chosen', async () => {
    daemon.calibrations.push({ id: 8, kind: 'flat', scan_id: 1, created_at: new Date(2026, 0, 2, 17, 34).toISOString() }, { id: 7, kind: 'dark', scan_id: 1, created_at: new Date(2026, 0, 2, 17, 31).toISOString() });
    await page.goto(url);
    await chooseSample();
    const card = page.getByTestId('calibrations');
    await card.getByText('Reused: white reference of scan 1 (2026-01-02 17:34), dark frames of scan 1 (2026-01-02 17:31).').waitFor();
    await card.getByLabel('take new dark frames').check();
    await card.getByText('Used again').waitFor({ state: 'detached' });
    await start().click();
    await expect.poll(plan).toEqual({ preset: 'paper', repeats: 1, reuse_calibrations: false });
  });

  it('shows why calibrations were interrupted, and resumes them', async () => {
    const id = daemon.addScan(1, 'paper');
    const scan = daemon.scans.find((s) => s.body.id === id);
    Object.assign(scan?.body ?? {}, { state: 'interrupted', reason: 'the daemon was stopped; resume the scan to continue', plan: { ...scan?.body.plan, repeats: 0 } });
    await page.goto(`${url}/#/result`);
    await page.getByRole('heading', { level: 1, name: 'Calibration' }).waitFor();
    await page.getByText('the daemon was stopped; resume the scan to continue').first().waitFor();
    await page.getByText('Neither the dark frames nor the white reference are complete, so scans do not use them.').waitFor();
    await page.getByRole('button', { name: 'Resume scan' }).click();
    await expect.poll(posts).toContain(`/scans/${id}/resume`);
  });

  it('adds a plastic with its uncertainty and a metal by its name, and reports faults beside their fields', async () => {
    const sent = (): unknown => daemon.requests.findLast((r) => r.path === '/samples')?.body;
    await page.goto(url);
    const sample = page.getByRole('combobox', { name: /^Part/ });
    await sample.selectOption({ label: 'New part …' });
    const form = page.getByTestId('sample-form');
    await form.getByLabel('Name', { exact: true }).fill('model 15°');
    await form.getByText('There is a part of this name already, no. 2.').waitFor();
    await form.getByLabel('Index n', { exact: true }).fill('abc');
    await form.getByText('“abc” is not a number.').waitFor();
    await form.getByRole('button', { name: 'Add part' }).click();
    expect(posts()).toEqual([]);
    await form.getByLabel('Index n', { exact: true }).fill('1,49');
    await form.getByLabel('Standard uncertainty of n').fill('0,02');
    await form.getByRole('button', { name: 'Add part' }).click();
    await expect.poll(sent).toEqual({ name: 'model 15°', material: { kind: 'dielectric', eta: 1.49, eta_std: 0.02 } });
    await expect.poll(() => sample.locator('option:checked').innerText()).toBe('model 15° (n 1.49)');
    await sample.selectOption({ label: 'New part …' });
    await form.getByLabel('Name', { exact: true }).fill('die 4');
    await form.getByLabel('Material').selectOption('metal');
    await form.getByRole('combobox', { name: 'Metal', exact: true }).selectOption('Cu');
    await form.getByRole('button', { name: 'Add part' }).click();
    await expect.poll(sent).toEqual({ name: 'die 4', metal: { name: 'Cu' } });
    await expect.poll(() => sample.locator('option:checked').innerText()).toBe('die 4 (n 3.12, κ 3.33)');
  });
});

describe('the part of the next scan', () => {
  const chosen = (): Promise<string> => page.getByRole('combobox', { name: /^Part/ }).locator('option:checked').innerText();

  it('is asked for before the first scan, and an import does not change it', async () => {
    await page.goto(url);
    await expect.poll(chosen).toBe('Which part is on the table?');
    expect(await page.getByRole('button', { name: 'Start scan' }).isDisabled()).toBe(true);
    daemon.addScan(2, 'paper');
    await page.reload();
    await expect.poll(chosen).toBe('model 15° (n 1.54)');
    const imported = daemon.addScan(daemon.addSample('polymer-10', { theta_r_deg: 10, alpha_u: 0.1, alpha_v: 0.1, rho_d: 0.3 }), 'paper');
    Object.assign(daemon.scans.find((s) => s.body.id === imported)?.body ?? {}, { origin: 'import' });
    await page.reload();
    await expect.poll(chosen).toBe('model 15° (n 1.54)');
  });

  it('is renamed, and a scan is assigned to another one, both with their trace', async () => {
    daemon.addScan(1, 'paper');
    await page.goto(url);
    await page.getByRole('button', { name: 'Rename …' }).click();
    await page.getByLabel('New name of the part').fill('B-17');
    await page.keyboard.press('Enter');
    await page.getByRole('heading', { level: 1, name: 'B-17' }).waitFor();
    await page.getByText(/before: traced polymer \(until/).waitFor();
    await page.getByRole('link', { name: 'Open the result' }).click();
    await page.getByRole('button', { name: 'Other part …' }).click();
    await page.locator('.sample select').selectOption({ label: 'model 15° (n 1.54)' });
    await page.getByRole('heading', { level: 1, name: 'model 15°' }).waitFor();
    await page.getByText(/Assigned to B-17 until/).waitFor();
    expect(daemon.requests.filter((r) => r.method === 'PATCH').map((r) => [r.path, r.body])).toEqual([['/samples/1', { name: 'B-17' }], ['/scans/1', { sample_id: 2 }]]);
    // Enter in the field has not started a scan.
    expect(daemon.requests.filter((r) => r.path === '/scans')).toEqual([]);
  });
});
