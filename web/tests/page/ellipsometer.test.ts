// The page with a mock daemon: the virtual ellipsometer.

import { describe, expect, it } from 'vitest';

import { daemon, page, posts, url } from './stage';

describe('the virtual ellipsometer', () => {
  it('does not send files that a request cannot carry', async () => {
    await page.goto(`${url}/#/lab`);
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
    await page.goto(`${url}/#/lab`);
    const form = page.getByTestId('trace-form');
    await form.getByLabel('Scene, TOML').fill('[light]\ntheta = x\n');
    await form.getByRole('button', { name: 'Trace' }).click();
    await form.getByRole('alert').filter({ hasText: 'TOML parse error at line 2' }).waitFor();
    const selected = await form.getByLabel('Scene, TOML').evaluate((e: HTMLTextAreaElement) => e.value.slice(e.selectionStart, e.selectionEnd));
    expect(selected).toBe('theta = x');
  });

  it('sends the files that a scene names, and does not select a line for a fault in one of them', async () => {
    daemon.refusals.set('POST /traces', { status: 422, body: { code: 'invalid-value', title: 'a value is not valid', detail: 'scene: interface 1: hills.csv: line 2 has 1 heights, the lines before it 2' } });
    await page.goto(`${url}/#/lab`);
    const form = page.getByTestId('trace-form');
    await form.getByLabel('Scene, TOML').fill('[[interface]]\nshape = "file"\npath = "hills.csv"\n');
    await form.getByLabel('Height files').setInputFiles({ name: 'hills.csv', mimeType: 'text/csv', buffer: Buffer.from('0,1\n2\n') });
    await form.getByRole('button', { name: 'Trace' }).click();
    await form.getByRole('alert').filter({ hasText: 'hills.csv: line 2 has 1 heights' }).waitFor();
    const selected = await form.getByLabel('Scene, TOML').evaluate((e: HTMLTextAreaElement) => e.value.slice(e.selectionStart, e.selectionEnd));
    expect(selected).toBe('');
    expect(daemon.requests.find((r) => r.path === '/traces')?.body).toMatchObject({ files: { 'hills.csv': Buffer.from('0,1\n2\n').toString('base64') } });
  });

  it('starts the example within its limits, shows the time left, and can be cancelled', async () => {
    await page.goto(`${url}/#/lab`);
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
    expect(await card.locator('[data-component]').count()).toBe(6);
    const disc = card.getByTestId('hemisphere');
    const reading = card.getByTestId('reading');
    const point = async (share: number): Promise<void> => {
      await disc.scrollIntoViewIfNeeded();
      const box = await disc.boundingBox();
      await disc.hover({ position: { x: share * (box?.width ?? 0), y: 0.5 * (box?.height ?? 0) + 2 } });
    };
    await point(0.75);
    expect(await reading.innerText()).toMatch(/^θ 45\.0°, φ 345\.0° 0\.2000 ± 0\.0020.sr⁻¹$/);
    await card.locator('[data-component=s1]').click();
    await point(0.75);
    expect(await reading.innerText()).toContain('−0.1000 ± 0.0020');
    await disc.press('ArrowDown');
    expect(await reading.innerText()).toContain('θ 55.0°');
    await card.locator('[data-component=dolp]').click();
    await point(0.99);
    expect(await reading.innerText()).toContain('no light');
    // Light that is linear along s: m00 + m01.
    await card.getByLabel('Lamp’s light').selectOption('1');
    await card.locator('[data-component=s0]').click();
    await point(0.75);
    expect(await reading.innerText()).toContain('0.1000 ± 0.0028');
    await card.getByRole('button', { name: 'Mueller' }).click();
    expect(await card.locator('[data-component]').count()).toBe(16);
    await card.getByRole('button', { name: 'Against scalar' }).click();
    await card.locator('[data-component=adm]').click();
    await point(0.75);
    expect(await reading.innerText()).toContain('15.00 ± 0.80');
    expect(await card.getByRole('button', { name: 'Transmitted' }).isDisabled()).toBe(true);
  });
});
