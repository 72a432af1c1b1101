// The page in a real browser on the real daemon: bytes go through pty, codec, store, reduction and fit.

import type { Page } from 'playwright-core';
import { afterAll, afterEach, beforeAll, beforeEach, describe, expect, it } from 'vitest';

import { openBrowser, type OpenBrowser } from '../browser';
import { startDaemon, type RunningDaemon } from '../daemon';
import { completed, doSteps, fillPart, fillScan, fitted, openPart, openView, saveSpecification } from '../operate';

const TIME_SCALE = 50;
/** Enough poses that a test that is delayed by seconds still finds its scan running. */
const LONG_GRID = { grid: 'custom', tilts: '-20:5:20', azimuths: '0:5:355' } as const;
/** One paper scan at this time scale with a debug binary on a busy machine. */
const SCAN_MS_MAX = 120_000;
/** A map, a contrast table or a verdict of such a scan. */
const CALCULATION_MS_MAX = 240_000;

let browser: OpenBrowser;
let daemon: RunningDaemon;
let page: Page;
let faults: string[];

beforeAll(async () => {
  [browser, daemon] = await Promise.all([openBrowser(), startDaemon(TIME_SCALE)]);
});
afterAll(async () => {
  await browser?.close();
  await daemon?.stop();
});
beforeEach(async () => {
  page = await browser.context.newPage();
  faults = [];
  page.on('pageerror', (error) => faults.push(error.message));
  await page.goto(daemon.url);
  await page.getByRole('button', { name: 'Start scan' }).waitFor();
});
afterEach(async () => {
  await page.close();
  expect(faults).toEqual([]);
});

async function get(path: string): Promise<Record<string, unknown>> {
  const response = await fetch(`${daemon.url}/api/v1${path}`);
  return (await response.json()) as Record<string, unknown>;
}

/** Opens the result of the traced polymer. */
async function openFirstScan(part = 'curves'): Promise<void> {
  await page.goto(`${daemon.url}/#/result/1/${part}`);
  await page.getByRole('heading', { level: 1, name: 'traced polymer' }).waitFor();
}

/** Starts the scan of the form, and waits until the daemon has accepted it. */
async function startScan(): Promise<void> {
  await page.getByRole('button', { name: 'Start scan' }).click();
  await expect.poll(async () => (await get('/rig'))['scan_id'], { timeout: 20_000 }).not.toBeNull();
}

/** The running or paused scan. Its progress is read from the daemon, since the page may lag. */
async function scanNow(): Promise<{ id: number; state: string; fraction: number }> {
  const { scan_id: id } = (await get('/rig')) as { scan_id: number | null };
  if (id === null) throw new Error('the scan has ended: it was too short for this test');
  const { state, progress } = (await get(`/scans/${id}`)) as { state: string; progress: { fraction: number } };
  return { id, state, fraction: progress.fraction };
}

/** Pauses the scan at this progress; returns whether it is paused. Not through the page, since a click may come too late. */
async function pausedAt(fraction: number): Promise<boolean> {
  const scan = await scanNow();
  if (scan.fraction >= fraction && scan.state === 'running') await fetch(`${daemon.url}/api/v1/scans/${scan.id}/pause`, { method: 'POST' });
  return scan.fraction >= fraction && scan.state === 'paused';
}

describe('a lab’s day', () => {
  it('scans a part with its operator steps, fits it, and the numbers change with the part', async () => {
    await fillScan(page, { sample: 'traced polymer', grid: 'paper' });
    await page.getByText(/\d+ frames/).first().waitFor();
    await page.getByRole('button', { name: 'Start scan' }).click();
    const steps = await doSteps(page, completed(page), SCAN_MS_MAX);
    expect(steps).toEqual(['Cap the lens', 'Place the white reference', 'Place the part traced polymer']);

    const polymer = await fitted(page, 60_000);
    // The true angle of the traced part is 10°; its uncertainty is covered by the tests of the fit.
    expect(Math.abs(polymer.theta_r_deg - 10)).toBeLessThan(0.5);
    // Few poses leave few degrees of freedom, so that k is stated.
    expect(polymer.text).toMatch(/^\d+\.\d+ ± \d+\.\d+° k = \d\.\d+$/);
    await page.getByRole('link', { name: 'Open the result' }).click();
    await page.getByRole('button', { name: 'sawtooth', exact: true }).waitFor();
    await expect.poll(() => page.getByTestId('curves').locator('figure').count()).toBe(5);
    const [fit] = (await get('/fits'))['items'] as { parameters: Record<string, { value: number; expanded: number }> }[];
    expect(polymer.theta_r_deg).toBeCloseTo(fit?.parameters['theta_r_deg']?.value ?? Number.NaN, 1);

    await openView(page, 'Measure');
    await fillScan(page, { sample: 'model 15°', grid: 'paper' });
    await page.getByRole('button', { name: 'Start scan' }).click();
    await page.getByRole('heading', { level: 1, name: 'model 15°' }).waitFor();
    await doSteps(page, completed(page), SCAN_MS_MAX);
    const model = await fitted(page, 60_000);
    expect(Math.abs(model.theta_r_deg - 15)).toBeLessThan(0.5);
    await expect.poll(() => page.getByTestId('last-results').locator('tbody tr').count()).toBe(2);
    await openView(page, 'Records');
    await page.getByLabel('Search').fill('polymer');
    await expect.poll(() => page.getByTestId('scans').locator('tbody tr').count()).toBe(1);
    expect(await page.getByTestId('scans').innerText()).toContain(polymer.text.split(' ')[0]);
  });

  it('shows the counts of the camera, pixel by pixel', async () => {
    await openFirstScan('frames');
    const canvas = page.getByTestId('frame');
    const frames = (await get('/scans/1/frames?limit=1000'))['items'] as { id: number }[];
    // The frame of the newest scan may still be shown for a moment.
    const shown = async (): Promise<number> => Number(await canvas.getAttribute('data-frame-id'));
    await expect.poll(shown, { timeout: 20_000 }).toSatisfy((id: unknown) => frames.some((f) => f.id === id));
    const id = await shown();
    const pixels = await fetch(`${daemon.url}/api/v1/frames/${id}/pixels`);
    const width = Number(pixels.headers.get('x-width-px'));
    const counts = new Uint16Array(await pixels.arrayBuffer());
    await page.locator('.stage').focus();
    await page.keyboard.press('ArrowRight');
    const readout = (await page.getByTestId('pixel').innerText()).replace(/\u202f/g, '');
    const [, column, row, dn] = /column (\d+), row (\d+): (\d+) DN/.exec(readout) ?? [];
    expect(Number(dn)).toBe(counts[Number(row) * width + Number(column)]);
    // Without counts beyond 8 bits the test would prove nothing.
    expect(new Set(counts).size).toBeGreaterThan(256);
  });

  it('shows beside the file what a measured shape lacks', async () => {
    await openFirstScan();
    const form = page.getByTestId('fit-form');
    await form.getByLabel('Model').selectOption('traced');
    await form.getByLabel('Height file').setInputFiles({ name: 'map.csv', mimeType: 'text/csv', buffer: Buffer.from('0,1,2\n0,1,2\n0,1,2\n') });
    await form.getByRole('button', { name: /^Fit/ }).click();
    await form.getByRole('alert').filter({ hasText: 'map.csv: the file does not state the spacing of its samples' }).waitFor();
    await form.getByLabel('Sample spacing, µm').fill('1');
    await form.getByLabel('Height unit, µm').fill('1');
    await form.getByRole('button', { name: /^Fit/ }).click();
    // Both units were accepted; the remaining fault is in the map itself.
    await form.getByRole('alert').filter({ hasText: /map\.csv: (?!the file does not state)/ }).waitFor();
  });

  it('stops at once by the STOP button during a scan, and resumes', async () => {
    await fillScan(page, { sample: 'model 15°', ...LONG_GRID });
    await startScan();
    // All operator steps are done at this point.
    await doSteps(page, async () => (await scanNow()).fraction > 0.05, SCAN_MS_MAX);
    await page.getByRole('button', { name: /STOP/ }).click();
    await page.getByRole('button', { name: 'Resume' }).waitFor();
    const rig = (await get('/rig')) as { axes: Record<string, { moving: boolean }> };
    expect(Object.values(rig.axes).map((axis) => axis.moving)).toEqual([false, false]);
    await page.getByRole('button', { name: 'Resume' }).click();
    await page.getByRole('button', { name: 'Pause' }).waitFor();
    await page.getByRole('button', { name: 'Abort …' }).click();
    await page.getByRole('button', { name: 'Abort for good' }).click();
    await page.getByRole('button', { name: 'Start scan' }).waitFor();
  });

  it('shows the uncertainty of the ridge angle falling while the scan runs', async () => {
    await fillScan(page, { sample: 'traced polymer', ...LONG_GRID });
    await startScan();
    const line = page.getByTestId('certainty').locator('[data-line=theta_r_deg]');
    /** The displayed expanded uncertainty; NaN before there is one. */
    const std = async (): Promise<number> => ((await line.count()) === 0 ? Number.NaN : Number.parseFloat((await line.innerText()).split('±')[1] ?? ''));
    // A pause gives the live fit the time that a debug binary needs.
    await doSteps(page, () => pausedAt(0.1), SCAN_MS_MAX);
    await expect.poll(std, { timeout: 90_000 }).toBeGreaterThan(0);
    const early = await std();
    await page.getByRole('button', { name: 'Resume' }).click();
    await doSteps(page, () => pausedAt(0.25), SCAN_MS_MAX);
    await expect.poll(std, { timeout: 90_000 }).toBeLessThan(early);
    // A line needs three points.
    await page.getByRole('button', { name: 'Resume' }).click();
    await doSteps(page, () => pausedAt(0.4), SCAN_MS_MAX);
    await expect.poll(() => page.getByTestId('certainty').locator('canvas').count(), { timeout: 90_000 }).toBe(1);
    // A page that is opened now shows the earlier rows.
    await page.reload();
    await expect.poll(async () => Number(await page.getByTestId('certainty').getAttribute('data-rows'))).toBeGreaterThanOrEqual(2);
    await page.getByRole('button', { name: 'Abort …' }).click();
    await page.getByRole('button', { name: 'Abort for good' }).click();
    await page.getByRole('button', { name: 'Start scan' }).waitFor();
  });

  it('maps a scan, measures its contrast and judges it against limits', async () => {
    await openFirstScan('map');
    const card = page.getByTestId('calculations');
    await card.getByRole('button', { name: 'Map every pixel' }).click();
    await card.getByRole('progressbar').waitFor();
    const picture = card.getByTestId('map-picture');
    await picture.waitFor({ timeout: CALCULATION_MS_MAX });
    const { camera } = (await get('/rig')) as { camera: { width_px: number } };
    expect(await picture.evaluate((canvas: HTMLCanvasElement) => canvas.width)).toBe(camera.width_px);
    await card.getByRole('img', { name: /arrow keys move a cross/ }).press('ArrowRight');
    expect(await card.getByTestId('map-pixel').innerText()).toMatch(/column \d+, row \d+:\s+(\d+\.\d+ ± \d+\.\d+°|no value)/);
    const [map] = (await get('/maps'))['items'] as { parameters: Record<string, { median: number; std_shared: number }> }[];
    const median = Number.parseFloat(await card.getByTestId('map-parameters').locator('td').first().innerText());
    expect(median).toBeCloseTo(map?.parameters['theta_r_deg']?.median ?? Number.NaN, 1);
    expect(Math.abs(median - 10)).toBeLessThan(0.5);

    await openPart(page, 'Contrast');
    await card.getByRole('button', { name: 'Measure contrast' }).click();
    await card.getByTestId('contrast').waitFor({ timeout: CALCULATION_MS_MAX });
    await expect.poll(() => card.getByTestId('contrast').locator('tbody tr').count()).toBe(5);

    await openPart(page, 'Verdict');
    const verdict = card.getByTestId('verdict');
    const judge = async (lower: string, upper: string): Promise<void> => {
      await card.getByLabel('ridge angle: lower limit').fill(lower);
      await card.getByLabel('ridge angle: upper limit').fill(upper);
      await card.getByRole('button', { name: 'Judge' }).click();
    };
    await judge('9', '11');
    await verdict.filter({ hasText: 'pass' }).waitFor({ timeout: CALCULATION_MS_MAX });
    await judge('12', '');
    await verdict.filter({ hasText: 'fail' }).waitFor({ timeout: CALCULATION_MS_MAX });
  }, 2 * CALCULATION_MS_MAX);

  it('traces a scene, and the page shows the expected physics', async () => {
    await openView(page, 'Lab');
    const card = page.getByTestId('traces');
    const form = card.getByTestId('trace-form');
    await form.getByText('As TOML').click();
    await form.getByLabel('Scene, TOML').fill('[[interface]]\nshape = "flat"\nbelow = { n = 0 }\n');
    await form.getByRole('button', { name: 'Trace' }).click();
    await form.getByRole('alert').filter({ hasText: 'below.n' }).waitFor();
    // At Brewster's angle of glass only s light is reflected.
    await form.getByLabel('Scene, TOML').fill('# Brewster\n[light]\ntheta_i_deg = 56.31\nphi_i_deg = 195.0\n[[interface]]\nshape = "flat"\nbelow = { n = 1.5 }\n[run]\ntheta_bins = 9\nphi_bins = 12\n');
    await form.getByLabel('Photons').fill('2000');
    await form.getByRole('button', { name: 'Trace' }).click();
    await card.getByTestId('plane-curves').waitFor({ timeout: CALCULATION_MS_MAX });
    const reflected = Number.parseFloat(await card.getByTestId('trace-energy').locator('td').first().innerText());
    expect(reflected).toBeCloseTo(0.0739645, 4);
    expect(await card.getByTestId('trace-list').innerText()).toMatch(/Brewster[^]*done/);
    await card.locator('[data-component=dolp]').click();
    const disc = card.getByTestId('hemisphere');
    await disc.scrollIntoViewIfNeeded();
    const box = await disc.boundingBox();
    // The middle of the bin of the mirror direction: θ 55°, φ 15°.
    const [x, y] = [Math.cos(Math.PI / 12), Math.sin(Math.PI / 12)].map((c) => (c * 55) / 90) as [number, number];
    const mirrored = { x: 0.5 * (1 + x) * (box?.width ?? 0), y: 0.5 * (1 - y) * (box?.height ?? 0) };
    // The layer is read when it is chosen, so the pointer comes again until there is something to read.
    const reading = async () => {
      await disc.hover({ position: { x: 1, y: 1 } });
      await disc.hover({ position: mirrored });
      return card.getByTestId('reading').innerText();
    };
    await expect.poll(reading).toMatch(/φ 15\.0° 1\.000/);
    const [trace] = (await get('/traces'))['items'] as { id: number; files: string[] }[];
    for (const file of trace?.files ?? []) expect((await fetch(`${daemon.url}/api/v1/traces/${trace?.id}/files/${file}`)).status).toBe(200);
  });

  it('moves an axis by hand and reads the position back', async () => {
    await openView(page, 'Rig');
    const axis = page.locator('[data-axis=theta_c]');
    await axis.getByRole('button', { name: 'Move', exact: true }).waitFor();
    if (await axis.getByText('not homed').isVisible()) {
      await axis.getByRole('button', { name: 'Home' }).click();
      await axis.getByText('homed', { exact: true }).waitFor();
    }
    await page.getByLabel('camera tilt: move to, degrees').fill('7.5');
    await axis.getByRole('button', { name: 'Move', exact: true }).click();
    await expect.poll(async () => Number.parseFloat((await axis.locator('output').innerText()).replace('−', '-')), { timeout: 20_000 }).toBeCloseTo(7.5, 1);
  });

  it('adds a metal by its name, and names the calibrations of earlier scans unless new ones are chosen', async () => {
    const samples = page.getByRole('combobox', { name: /^Part/ });
    await samples.selectOption({ label: 'New part …' });
    const form = page.getByTestId('sample-form');
    await form.getByLabel('Name', { exact: true }).fill('die 4');
    await form.getByLabel('Material').selectOption('metal');
    await form.getByRole('button', { name: 'Add part' }).click();
    // Chromium at the lamp's wavelength, from the daemon's tables.
    await expect.poll(() => samples.locator('option:checked').innerText()).toMatch(/^die 4 \(n [23]\.\d+, κ [2345]\.\d+\)$/);
    const calibrations = page.getByTestId('calibrations');
    await calibrations.getByText(/^Reused: white reference of scan \d+ \(.*\), dark frames of scan \d+ \(.*\)\.$/).waitFor();
    await calibrations.getByLabel('take new dark frames').check();
    await page.getByText('You will be asked to: cap the lens, place the white reference, place the part.').waitFor();
  });

  it('takes calibrations only, shows their validity, and leaves only the part to the next scan', async () => {
    await fillScan(page, { sample: 'model 15°', grid: 'custom', tilts: '1, 2', azimuths: '0, 90' });
    await page.getByText('You will be asked to: place the white reference, place the part.').waitFor();
    await page.getByRole('button', { name: 'Calibrate only' }).click();
    await page.getByRole('heading', { level: 1, name: 'Calibration' }).waitFor();
    const { scan_id: id } = (await get('/rig')) as { scan_id: number };
    const steps = await doSteps(page, completed(page), SCAN_MS_MAX);
    expect(steps).toEqual(['Cap the lens', 'Place the white reference']);
    const taken = page.getByTestId('taken').locator('li');
    await expect.poll(() => taken.allInnerTexts()).toEqual([
      expect.stringMatching(/^dark frames, \d+ frames at .* ms: scans of this rig use it until /),
      expect.stringMatching(/^white reference, \d+ frames at .* ms, camera tilts 1°, 2°: scans of this rig use it until /),
    ]);
    await page.getByText('You will be asked to: place the part.').waitFor();
    await expect.poll(() => page.getByTestId('calibrations').innerText(), { timeout: 20_000 }).toContain(`white reference of scan ${id} (`);
    await page.goto(`${daemon.url}/#/result/${id}`);
    await page.getByTestId('taken').waitFor();
    // It has no form of a fit.
    expect(await page.getByRole('button', { name: 'Fit', exact: true }).count()).toBe(0);
  });

  it('shows nothing in place of a missing scan', async () => {
    await page.goto(`${daemon.url}/#/result/999`);
    await page.getByText('Scan 999 is not in this store.').waitFor();
    expect(await page.locator('#answer-title').count()).toBe(0);
  });

  it('shows as a sentence why a plan cannot run', async () => {
    await fillScan(page, { sample: 'model 15°', grid: 'custom', tilts: '0, 88', azimuths: '0' });
    const fault = page.locator('.fault').first();
    await fault.waitFor();
    expect(await fault.innerText()).toMatch(/88.*\.$/);
    expect(await page.getByRole('button', { name: 'Start scan' }).isDisabled()).toBe(true);
  });

  // The last one: with a recipe the form of the next part begins with it.
  it('goes from a recipe and a specification to the verdict and the report', async () => {
    await openView(page, 'Set-up');
    await page.getByRole('button', { name: 'New recipe' }).click();
    const recipe = page.getByTestId('recipe-form');
    await recipe.getByLabel(/^Name/).fill('PX-1204 rev C');
    await recipe.getByText('custom', { exact: true }).click();
    await recipe.getByLabel(/^Camera tilts/).fill('-20,-10,0,10,88');
    await recipe.getByLabel(/^Sample azimuths/).fill('0,90,180');
    await recipe.getByRole('combobox', { name: 'Model' }).selectOption('sawtooth');
    await recipe.getByRole('button', { name: 'Save the recipe' }).click();
    // The daemon's refusal is at its field.
    await recipe.getByText(/^Camera tilt: 88° is outside/).waitFor();
    await recipe.getByLabel(/^Camera tilts/).fill('-20,-10,0,10,20');
    await recipe.getByRole('button', { name: 'Save the recipe' }).click();
    await page.getByRole('button', { name: 'Change PX-1204 rev C' }).waitFor();
    await saveSpecification(page, 'drawing 4711 B', '9', '11');

    await openView(page, 'Measure');
    await fillPart(page, { sample: 'traced polymer', recipe: 'PX-1204 rev C', specification: 'drawing 4711 B', lot: '4' });
    await page.getByRole('button', { name: 'Start scan' }).click();
    await page.getByTestId('purpose').getByText('PX-1204 rev C, version 1 · lot 4').waitFor();
    await doSteps(page, completed(page), SCAN_MS_MAX);
    const part = await fitted(page, CALCULATION_MS_MAX);
    expect(Math.abs(part.theta_r_deg - 10)).toBeLessThan(0.5);
    await page.getByTestId('verdict-banner').filter({ hasText: 'pass' }).waitFor({ timeout: CALCULATION_MS_MAX });
    await page.getByTestId('last-results').locator('tbody tr').first().filter({ hasText: 'lot 4' }).filter({ hasText: 'pass' }).waitFor();
    const opened = page.context().waitForEvent('page');
    await page.getByRole('link', { name: 'Report', exact: true }).first().click();
    const report = await opened;
    const [value = ''] = part.text.split(' ');
    await report.getByText(value).first().waitFor();
    const words = await report.locator('body').innerText();
    for (const text of ['PX-1204 rev C', 'drawing 4711 B', 'traced polymer']) expect(words).toContain(text);
    expect(words.toLowerCase()).toContain('pass');
    await report.close();
  }, 3 * CALCULATION_MS_MAX);
});
