// The page with a mock daemon: the virtual ellipsometer.

import { describe, expect, it } from 'vitest';

import { axeViolations, daemon, page, posts, url } from './stage';

/** Opens Lab and the scene as TOML. */
async function openToml(): Promise<void> {
  await page.goto(`${url}/#/lab`);
  await page.getByTestId('trace-form').getByText('As TOML').click();
}
const traced = (): Record<string, unknown>[] => daemon.requests.filter((r) => r.path === '/traces').map((r) => r.body as Record<string, unknown>);

describe('the virtual ellipsometer', () => {
  it('does not send files that a request cannot carry', async () => {
    await openToml();
    const form = page.getByTestId('trace-form');
    await form.getByLabel('Height files').setInputFiles({ name: 'hills.tif', mimeType: 'image/tiff', buffer: Buffer.alloc(7_000_000) });
    await form.getByRole('button', { name: 'Trace' }).click();
    await form.getByRole('alert').filter({ hasText: 'hills.tif has 7.0 MB' }).waitFor();
    expect(posts()).toEqual([]);
  });

  it('shows under each field why nothing can be traced', async () => {
    await page.goto(`${url}/#/lab`);
    const form = page.getByTestId('trace-form');
    await form.getByLabel('Photons').fill('1,5e5');
    await form.getByText('Give a whole number above 0, e.g. 200000 or 2e5.').waitFor();
    await form.getByLabel('Time limit, s').fill('0');
    await form.getByText('Give a number of seconds above 0').waitFor();
    await form.getByLabel('Number of random surfaces').fill('5000');
    await form.getByText('Give a whole number from 2 to 1000').waitFor();
    expect(await form.getByRole('button', { name: 'Trace' }).isDisabled()).toBe(true);
  });

  it('reports a fault of a scene beside it and selects its line', async () => {
    daemon.refusals.set('POST /traces', { status: 422, body: { code: 'invalid-value', title: 'a value is not valid', detail: 'scene: the scene cannot be read: TOML parse error at line 2, column 9' } });
    await openToml();
    const form = page.getByTestId('trace-form');
    await form.getByLabel('Scene, TOML').fill('[light]\ntheta = x\n');
    await form.getByRole('button', { name: 'Trace' }).click();
    await form.getByRole('alert').filter({ hasText: 'TOML parse error at line 2' }).waitFor();
    const selected = await form.getByLabel('Scene, TOML').evaluate((e: HTMLTextAreaElement) => e.value.slice(e.selectionStart, e.selectionEnd));
    expect(selected).toBe('theta = x');
  });

  it('sends the files that a scene names, and does not select a line for a fault in one of them', async () => {
    daemon.refusals.set('POST /traces', { status: 422, body: { code: 'invalid-value', title: 'a value is not valid', detail: 'scene: interface 1: hills.csv: line 2 has 1 heights, the lines before it 2' } });
    await openToml();
    const form = page.getByTestId('trace-form');
    await form.getByLabel('Scene, TOML').fill('[[interface]]\nshape = "file"\npath = "hills.csv"\n');
    await form.getByLabel('Height files').setInputFiles({ name: 'hills.csv', mimeType: 'text/csv', buffer: Buffer.from('0,1\n2\n') });
    await form.getByRole('button', { name: 'Trace' }).click();
    await form.getByRole('alert').filter({ hasText: 'hills.csv: line 2 has 1 heights' }).waitFor();
    const selected = await form.getByLabel('Scene, TOML').evaluate((e: HTMLTextAreaElement) => e.value.slice(e.selectionStart, e.selectionEnd));
    expect(selected).toBe('');
    expect(daemon.requests.find((r) => r.path === '/traces')?.body).toMatchObject({ files: { 'hills.csv': Buffer.from('0,1\n2\n').toString('base64') } });
  });

  it('traces what its fields describe, and shows the TOML that they make', async () => {
    await openToml();
    const form = page.getByTestId('trace-form');
    await form.getByLabel('Shape').selectOption('rough');
    expect(await form.getByLabel('Ridge angle').count()).toBe(0);
    await form.getByLabel('along u').fill('0,2');
    await form.getByRole('combobox', { name: 'Body' }).selectOption('Cr');
    await form.getByLabel('Layer on top').check();
    await form.getByLabel('Layer index n').fill('1.6');
    const toml = form.getByLabel('Scene, TOML');
    expect(await toml.inputValue()).toContain('# Lamp at 45°: flat layer, n 1.6, over rough chromium\n');
    await form.getByRole('button', { name: 'Trace' }).click();
    await page.getByTestId('trace-list').getByText('Lamp at 45°: flat layer, n 1.6, over rough chromium').waitFor();
    const [scene] = traced().map((body) => String(body['scene']));
    for (const part of ['shape = "flat"\nbelow = { n = 1.6 }', 'shape = "beckmann"\nalpha_u = 0.2\nalpha_v = 0.2\nbelow = "Cr"']) expect(scene).toContain(part);
    // The next form begins with the scene of the last trace.
    await page.reload();
    await page.getByRole('button', { name: 'New trace' }).click();
    expect(await form.getByRole('combobox', { name: 'Body' }).inputValue()).toBe('Cr');
    expect(await form.getByLabel('Layer index n').inputValue()).toBe('1.6');
  });

  it('names the fault of a field beside it, and traces nothing until it is mended', async () => {
    await page.goto(`${url}/#/lab`);
    const form = page.getByTestId('trace-form');
    const angle = form.getByLabel('Ridge angle');
    await angle.fill('95');
    await form.getByText('Give an angle above 0° and up to 85°.').waitFor();
    expect(await angle.getAttribute('aria-invalid')).toBe('true');
    expect(await form.getByRole('button', { name: 'Trace' }).isDisabled()).toBe(true);
    expect(await axeViolations()).toEqual([]);
    await angle.fill('15');
    await form.getByLabel('Number of random surfaces').fill('4');
    await form.getByText('No surface of this scene is random.').waitFor();
    await form.getByLabel('Number of random surfaces').fill('');
    expect(await form.getByRole('button', { name: 'Trace' }).isDisabled()).toBe(false);
  });

  it('makes one trace for each angle of incidence, and reports a refusal beside the form', async () => {
    await page.goto(`${url}/#/lab`);
    const form = page.getByTestId('trace-form');
    await form.getByLabel('Angles of incidence').fill('40:10:60');
    await form.getByRole('button', { name: 'Trace 3 angles' }).click();
    await expect.poll(() => page.getByTestId('trace-list').locator('tbody tr').count()).toBe(3);
    expect(traced().map((body) => /theta_i_deg = (.+)/.exec(String(body['scene']))?.[1])).toEqual(['40.0', '50.0', '60.0']);
    daemon.refusals.set('POST /traces', { status: 422, body: { code: 'invalid-value', title: 'a value is not valid', detail: 'scene: too dark' } });
    await page.getByRole('button', { name: 'New trace' }).click();
    await form.getByRole('button', { name: 'Trace', exact: true }).click();
    await form.getByRole('alert').filter({ hasText: 'Scene: too dark.' }).waitFor();
  });

  it('traces an edited TOML, and says that the fields do not describe it', async () => {
    await openToml();
    const form = page.getByTestId('trace-form');
    const toml = form.getByLabel('Scene, TOML');
    await toml.fill((await toml.inputValue()).replace('seed = 1', 'seed = 7'));
    await form.getByText('The fields do not describe it.').waitFor();
    expect(await form.getByLabel('Ridge angle').isDisabled()).toBe(true);
    expect(await axeViolations()).toEqual([]);
    await form.getByRole('button', { name: 'Trace', exact: true }).click();
    await expect.poll(() => traced().length).toBe(1);
    expect(traced()[0]?.['scene']).toContain('seed = 7');
    await page.getByRole('button', { name: 'New trace' }).click();
    expect(await toml.inputValue()).toContain('seed = 7');
    await form.getByRole('button', { name: 'Discard it and use the fields' }).click();
    expect(await toml.inputValue()).toContain('seed = 1');
    expect(await form.getByLabel('Ridge angle').isDisabled()).toBe(false);
    // An example fills the fields; one that they cannot describe is TOML.
    await form.getByLabel('Start from an example').selectOption('rough glass over gold');
    expect(await form.getByRole('combobox', { name: 'Body' }).inputValue()).toBe('Au');
    await form.getByLabel('Start from an example').selectOption('gold-coated sandpaper');
    await form.getByText('The fields do not describe it.').waitFor();
    expect(await toml.inputValue()).toContain('shape = "crystals"');
  });

  it('starts the example within its limits, shows the time left, and can be cancelled', async () => {
    await openToml();
    const form = page.getByTestId('trace-form');
    expect(await form.getByLabel('Scene, TOML').inputValue()).toContain('[[interface]]');
    await form.getByLabel('Photons').fill('2e5');
    await form.getByLabel('Target error').fill('1,5');
    await form.getByRole('button', { name: 'Trace' }).click();
    const card = page.getByTestId('traces');
    await card.getByText('tracing photons, 42 s left').waitFor();
    expect(daemon.requests.find((r) => r.path === '/traces')?.body).toMatchObject({ photons: 200_000, max_seconds: 60, target_error: 0.015, compare: true });
    await card.getByRole('button', { name: 'Cancel' }).click();
    await card.getByText('was cancelled').waitFor();
  });

  it('shows the energies, every component, the plane of incidence and the omissions', async () => {
    await page.goto(`${url}/#/lab`);
    const card = page.getByTestId('traces');
    await card.getByRole('button', { name: 'Trace', exact: true }).click();
    await card.getByRole('progressbar').waitFor();
    daemon.finishTrace();
    await card.getByTestId('plane-curves').waitFor();
    const words = (await card.innerText()).replace(/\s+/g, ' ');
    for (const part of ['0.70000 ± 0.00080', 'R2', '500 000', 'The target error 0.01 was not reached', 'interference and diffraction', '15 % (15 %)']) expect(words).toContain(part);
    await expect.poll(() => card.locator('[data-component]').count()).toBe(6);
    const disc = card.getByTestId('hemisphere');
    const reading = card.getByTestId('reading');
    const point = async (share: number): Promise<void> => {
      await disc.scrollIntoViewIfNeeded();
      const box = await disc.boundingBox();
      await disc.hover({ position: { x: share * (box?.width ?? 0), y: 0.5 * (box?.height ?? 0) + 2 } });
    };
    await point(0.75);
    await expect.poll(() => reading.innerText()).toMatch(/^θ 45\.0°, φ 345\.0° 0\.2000 ± 0\.0020\u00a0sr⁻¹$/);
    await card.locator('[data-component=s1]').click();
    await point(0.75);
    await expect.poll(() => reading.innerText()).toContain('−0.1000 ± 0.0020');
    await disc.press('ArrowDown');
    await expect.poll(() => reading.innerText()).toContain('θ 55.0°');
    await card.locator('[data-component=dolp]').click();
    await point(0.99);
    await expect.poll(() => reading.innerText()).toContain('no light');
    // Light that is linear along s: m00 + m01.
    await card.getByLabel('Lamp’s light').selectOption('1');
    await card.locator('[data-component=s0]').click();
    await point(0.75);
    await expect.poll(() => reading.innerText()).toContain('0.1000 ± 0.0028');
    const readings = card.getByTestId('plane-readings');
    expect((await readings.locator('tbody tr').first().innerText()).split('\t')).toEqual(['unpolarised', '0.2000 ± 0.0020', '−0.1000 ± 0.0020', '0.0000 ± 0.0020', '0.0000 ± 0.0020', '0.500 ± 0.012', '90.00 ± 0.60°']);
    expect((await card.getByTestId('psi-delta').innerText()).replace(/\s+/g, ' ')).toContain('Ψ 42.20 ± 0.20° Δ 122.60 ± 0.80° degree of polarisation –');
    await card.getByRole('combobox', { name: 'Angle of reflection' }).selectOption({ label: '40°, mirror direction' });
    expect(await axeViolations()).toEqual([]);
    await card.getByRole('button', { name: 'Mueller' }).click();
    await expect.poll(() => card.locator('[data-component]').count()).toBe(16);
    await card.getByRole('button', { name: 'Against scalar' }).click();
    await card.locator('[data-component=adm]').click();
    await point(0.75);
    await expect.poll(() => reading.innerText()).toContain('15.00 ± 0.80');
    expect(await card.getByRole('button', { name: 'Transmitted' }).isDisabled()).toBe(true);
  });
});
