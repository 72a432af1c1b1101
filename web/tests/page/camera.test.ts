// The page with a mock daemon: looks through the camera before a scan.

import { describe, expect, it } from 'vitest';

import { chooseSample, daemon, page, text, url } from './stage';

const camera = '[data-testid=camera]';
const looks = (): unknown[] => daemon.requests.filter((r) => r.path === '/rig/preview').map((r) => r.body);

/** Opens Measure and its camera. */
async function openCamera(): Promise<void> {
  await page.goto(url);
  await page.getByRole('button', { name: 'Camera' }).click();
  await page.getByRole('button', { name: 'Take a look' }).waitFor();
}

describe('the camera', () => {
  it('shows a look only when it is asked to, with picture, histogram and figures', async () => {
    await openCamera();
    expect(looks()).toEqual([]);
    await page.getByRole('button', { name: 'Take a look' }).click();
    await page.locator(`${camera} img[data-shown="1"]`).waitFor();
    expect(looks()).toEqual([{ exposures_s: [0.02], suggest: 0 }]);
    const words = await text(camera);
    expect(words).toContain('40 % brightest pixel, of full scale');
    expect(words).toContain('saturated 0 px');
    expect(words).toContain('defects 5 px, masked');
    expect(words).toContain('focus 3.42 %/px');
    expect(words).toContain('θc 0°, φs 90°, 20 ms. Nothing is stored.');
    expect(await page.locator(`${camera} svg[role=img]`).getAttribute('aria-label')).toMatch(/^Histogram from 0 to 65\s536 DN/);
  });

  it('suggests exposures, which the form of the scan takes', async () => {
    await openCamera();
    await chooseSample();
    await page.getByRole('button', { name: 'Suggest exposures' }).click();
    await page.getByText('Set for the next scan: 35 ms and 100 ms.').waitFor();
    expect(await page.getByLabel('Exposures, ms').inputValue()).toBe('35, 100');
    expect(await page.getByTestId('exposure-warning').count()).toBe(0);
    await page.getByRole('button', { name: 'Start scan' }).click();
    await expect.poll(() => (daemon.requests.find((r) => r.path === '/scans')?.body as { plan?: { exposures_s?: number[] } } | undefined)?.plan?.exposures_s).toEqual([0.035, 0.1]);
    // The camera belongs to the scan.
    await expect.poll(() => page.locator(camera).count()).toBe(0);
  });

  it('states whose exposures a recipe uses, and no pose that is not known', async () => {
    daemon.recipes.add({ name: 'PX-1204', plan: { preset: 'paper' } });
    daemon.recipes.add({ name: 'PX-1205', plan: { preset: 'paper', exposures_s: [0.01] } });
    Object.assign(daemon.axes.theta_c, { position_deg: -65, referenced: false, homed: false });
    await openCamera();
    const recipes = page.getByRole('combobox', { name: 'Recipe' });
    const suggest = page.getByRole('button', { name: 'Suggest exposures' });
    await recipes.selectOption('PX-1204');
    await suggest.click();
    await page.getByText('The recipe PX-1204 uses the exposures of the rig; a new version of it can state these. A brighter pose may saturate: suggest them at the brightest pose once the axes are homed.').waitFor();
    await recipes.selectOption('PX-1205');
    Object.assign(daemon.axes.theta_c, { referenced: true, homed: true });
    await suggest.click();
    await page.getByText('The recipe PX-1205 states its own exposures; a new version of it can state these. A brighter pose may saturate: suggest them at the brightest pose, not at θc −65°.').waitFor();
  });

  it('goes to the pose of the grid that is brightest for the newest ridge angle', async () => {
    daemon.axes.theta_c.position_deg = -60;
    await openCamera();
    await page.getByText('The next scan is brightest at θc 0°, φs 0°, for a flat sample.').waitFor();
    daemon.addFit(daemon.addScan(2, 'paper'));
    daemon.axes.theta_c.position_deg = -60;
    await page.reload();
    await page.getByRole('button', { name: 'Camera' }).click();
    await page.getByText('The next scan is brightest at θc 10°, φs 0°, for ridges of 15° as in the newest result.').waitFor();
    await page.getByRole('button', { name: 'Go there' }).click();
    await page.getByText('The rig is there.').waitFor();
    expect(daemon.requests.find((r) => r.path === '/rig/move')?.body).toEqual({ theta_c_deg: 10, phi_s_deg: 0 });
    expect(await page.getByRole('button', { name: 'Go there' }).isDisabled()).toBe(true);
  });

  it('warns about exposures that the last look shows to be absurd', async () => {
    await openCamera();
    await chooseSample();
    await page.getByRole('button', { name: 'Suggest exposures' }).click();
    const field = page.getByLabel('Exposures, ms');
    await expect.poll(() => field.inputValue()).toBe('35, 100');
    await field.fill('20000');
    await expect.poll(() => text('[data-testid=exposure-warning]')).toContain('20 s is too long at that pose');
    await field.fill('0.02');
    await expect.poll(() => text('[data-testid=exposure-warning]')).toContain('0.02 ms uses less than 3 %');
    await field.fill('20, 60');
    await expect.poll(() => page.getByTestId('exposure-warning').count()).toBe(0);
  });

  it('names a saturated picture, and is live at most twice a second while it is on', async () => {
    await page.goto(`${url}/#/rig`);
    await page.getByLabel('Exposure, ms').fill('500');
    const begun = Date.now();
    await page.getByRole('switch', { name: 'Live' }).check();
    await expect.poll(() => looks().length, { timeout: 5000 }).toBeGreaterThan(2);
    expect(Date.now() - begun).toBeGreaterThan(1000);
    expect(await text(camera)).toContain('saturated shorten the exposure');
    await page.getByRole('switch', { name: 'Live' }).uncheck();
    await page.waitForTimeout(200);
    const n = looks().length;
    await page.waitForTimeout(1200);
    expect(looks()).toHaveLength(n);
    await page.getByLabel('Exposure, ms').fill('0');
    await page.getByText('give a number above 0 and up to 60 000 ms').waitFor();
    expect(await page.getByRole('button', { name: 'Take a look' }).isDisabled()).toBe(true);
  });

  it('ends the live picture with the reason where the daemon refuses', async () => {
    await page.goto(`${url}/#/rig`);
    daemon.refusals.set('POST /rig/preview', { status: 503, body: { status: 503, code: 'camera-failed', title: 'the camera failed', detail: 'no frame came within 10.0 s: check the camera’s program' } });
    await page.getByRole('switch', { name: 'Live' }).click();
    await page.getByText('no frame came within 10.0 s').waitFor();
    expect(await page.getByRole('switch', { name: 'Live' }).isChecked()).toBe(false);
    expect(looks()).toHaveLength(1);
  });
});

describe('the newest frame of a running scan', () => {
  it('is the newest on record, where the page was loaded during the scan', async () => {
    await page.goto(url);
    await chooseSample();
    await page.getByRole('button', { name: 'Start scan' }).click();
    await page.getByText('Appears with the first frame.').waitFor();
    await page.getByRole('button', { name: 'Continue' }).click();
    await page.getByRole('heading', { name: 'Place the white reference' }).waitFor();
    await page.reload();
    await page.getByTestId('newest-frame').getByRole('img', { name: /^Frame \d+$/ }).waitFor();
    expect(await text('[data-testid=newest-frame] .words')).toContain('dark frame, ');
  });

  it('is a small picture, not the whole file', async () => {
    daemon.frameMs = 120;
    await openCamera();
    await chooseSample();
    await page.getByRole('button', { name: 'Start scan' }).click();
    for (let i = 0; i < 3; i++) await page.getByRole('button', { name: 'Continue' }).click();
    await page.getByText(/^sample, [1-9]\d* of/).waitFor();
    await page.getByTestId('newest-frame').locator('canvas').waitFor();
    expect(await text('[data-testid=newest-frame]')).toContain('the brightest 0.2 % of the pixels are above 36 % of full scale');
    expect(daemon.reads.some((path) => path.includes('/preview.png?width=256'))).toBe(true);
    // Also on a tablet, where the answer of the scan is below it.
    await page.setViewportSize({ width: 768, height: 1024 });
    expect((await page.getByTestId('newest-frame').boundingBox())?.height).toBeLessThan(512);
    expect(daemon.reads.filter((path) => path.endsWith('/image.png'))).toEqual([]);
  });
});
