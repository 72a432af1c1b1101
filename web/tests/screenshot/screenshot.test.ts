// Makes the pictures of the documents, docs/pictures/screenshot*.png, from a short day on the simulated rig. `make screenshots` runs it.

import { mkdir } from 'node:fs/promises';
import { join } from 'node:path';

import type { Page } from 'playwright-core';
import { afterAll, beforeAll, expect, it } from 'vitest';

import { openBrowser, type OpenBrowser } from '../browser';
import { startDaemon, type RunningDaemon } from '../daemon';
import { completed, doSteps, fillPart, fitted, openPart, openView } from '../operate';

const PICTURES = join(import.meta.dirname, '../../../docs/pictures');
const SCAN_MS_MAX = 300_000;

let daemon: RunningDaemon;
const browsers: OpenBrowser[] = [];

beforeAll(async () => {
  await mkdir(PICTURES, { recursive: true });
  // Slow enough to show the uncertainty of the live fit falling.
  daemon = await startDaemon(10);
});
afterAll(async () => {
  await Promise.all(browsers.map((b) => b.close()));
  await daemon?.stop();
});

async function openPage(options: { width?: number; height?: number; dark?: boolean } = {}): Promise<Page> {
  const browser = await openBrowser({ width: 1440, height: 1000, ...options });
  browsers.push(browser);
  return browser.context.newPage();
}

async function picture(page: Page, name: string): Promise<void> {
  await page.mouse.move(700, 20);
  await page.waitForTimeout(500);
  await page.screenshot({ path: join(PICTURES, `screenshot${name}.png`) });
}

const SPECIFICATION = 'drawing 4711 B';

/** What a lab has before its first part. */
async function save(path: string, body: object): Promise<void> {
  const response = await fetch(`${daemon.url}/api/v1${path}`, { method: 'POST', headers: { 'content-type': 'application/json' }, body: JSON.stringify(body) });
  expect(response.status, await response.text()).toBe(201);
}

async function scan(page: Page, sample: string, recipe: string): Promise<void> {
  await fillPart(page, { sample, recipe, specification: SPECIFICATION, lot: '4' });
  await page.getByRole('button', { name: 'Start scan' }).click();
  await page.getByRole('heading', { level: 1, name: sample }).waitFor();
  await doSteps(page, completed(page), SCAN_MS_MAX);
  await fitted(page, SCAN_MS_MAX);
  await page.getByTestId('verdict-banner').getByRole('link').waitFor({ timeout: SCAN_MS_MAX });
}

it('makes the pictures of a day at the rig', async () => {
  await save('/recipes', { name: 'PX-1204 rev C', plan: { preset: 'paper' }, target_expanded_deg: 0.05 });
  await save('/recipes', { name: 'PX-1204 full', plan: { preset: 'full' }, target_expanded_deg: 0.05 });
  await save('/specifications', { name: SPECIFICATION, limits: { theta_r_deg: { lower: 9, upper: 11 } } });
  const page = await openPage();
  await page.goto(daemon.url);
  await page.getByRole('button', { name: 'Start scan' }).waitFor();
  for (const sample of ['model 15°', 'traced polymer']) await scan(page, sample, 'PX-1204 rev C');
  // A scan that runs: what the operator sees.
  await fillPart(page, { sample: 'traced polymer', recipe: 'PX-1204 full', specification: SPECIFICATION, lot: '4' });
  await page.getByRole('button', { name: 'Start scan' }).click();
  await doSteps(page, async () => /^[3-9]\d %$/.test((await page.locator('.figures b').first().innerText().catch(() => '')).trim()), SCAN_MS_MAX);
  await page.evaluate(() => scrollTo(0, 0));
  await picture(page, '-measure');
  await doSteps(page, completed(page), SCAN_MS_MAX);
  await fitted(page, SCAN_MS_MAX);

  await page.getByTestId('verdict-banner').getByRole('link').waitFor({ timeout: SCAN_MS_MAX });

  await openView(page, 'Result');
  await page.getByRole('button', { name: 'sawtooth', exact: true }).waitFor({ timeout: 60_000 });
  await picture(page, '');
  // As a printer gets it, on the text width of A4.
  await page.emulateMedia({ media: 'print' });
  await page.setViewportSize({ width: 720, height: 1018 });
  await picture(page, '-print');
  await page.emulateMedia({ media: 'screen' });
  await page.setViewportSize({ width: 1440, height: 1000 });
  await openView(page, 'Records');
  await page.getByTestId('scans').locator('tbody tr').nth(2).waitFor();
  await picture(page, '-records');
  await openView(page, 'Rig');
  await page.getByTestId('calibration-list').locator('li').first().waitFor();
  await picture(page, '-rig');

  const night = await openPage({ dark: true });
  await night.goto(`${daemon.url}/#/result`);
  await openPart(night, 'Uncertainty');
  await night.getByTestId('parameters').waitFor({ timeout: 60_000 });
  await picture(night, '-dark');

  const phone = await openPage({ width: 390, height: 844 });
  await phone.goto(`${daemon.url}/#/result`);
  await phone.getByRole('button', { name: 'sawtooth', exact: true }).waitFor({ timeout: 60_000 });
  await picture(phone, '-phone');
  expect(await phone.evaluate(() => document.documentElement.scrollWidth - innerWidth)).toBeLessThanOrEqual(0);
});

it('makes the picture of the virtual ellipsometer', async () => {
  const page = await openPage();
  await page.goto(`${daemon.url}/#/lab`);
  const card = page.getByTestId('traces');
  await card.getByLabel('Start from an example').selectOption('rough glass over gold');
  await card.getByTestId('trace-form').getByLabel('Photons').fill('1e6');
  await card.getByRole('button', { name: 'Trace', exact: true }).click();
  await card.getByTestId('plane-curves').waitFor({ timeout: SCAN_MS_MAX });
  await card.getByRole('button', { name: 'Mueller' }).click();
  await card.locator('[data-component=m12]').click();
  await card.getByRole('heading', { name: 'Directions of the outgoing light' }).evaluate((e) => scrollTo(0, e.getBoundingClientRect().top + scrollY - 90));
  const disc = await card.getByTestId('hemisphere').boundingBox();
  await page.mouse.move((disc?.x ?? 0) + 0.8 * (disc?.width ?? 0), (disc?.y ?? 0) + 0.38 * (disc?.height ?? 0));
  await page.waitForTimeout(300);
  await page.screenshot({ path: join(PICTURES, 'screenshot-ellipsometer.png') });
});
