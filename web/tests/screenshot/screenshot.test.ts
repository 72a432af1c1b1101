// Makes docs/screenshot.png, docs/screenshot-dark.png (the full grid on the path-traced sample of the simulated rig, fitted) and
// docs/screenshot-ellipsometer.png (a traced scene) from real runs. `make screenshot` runs it.

import { mkdir } from 'node:fs/promises';
import { join } from 'node:path';

import { afterAll, beforeAll, expect, it } from 'vitest';

import { openBrowser, type OpenBrowser } from '../browser';
import { startDaemon, type RunningDaemon } from '../daemon';
import { completed, doSteps, fillScan, fitted, openPart, openView } from '../operate';

/** Device pixels per CSS pixel: sharp in the README, with few bytes. */
const SCALE = 1;

const DOCS = join(import.meta.dirname, '../../../docs');

let daemon: RunningDaemon;
const browsers: OpenBrowser[] = [];

beforeAll(async () => {
  // Slow enough to show the uncertainty of the live fit falling.
  daemon = await startDaemon(10);
});
afterAll(async () => {
  await Promise.all(browsers.map((b) => b.close()));
  await daemon?.stop();
});

it('makes the pictures of the README', async () => {
  await mkdir(DOCS, { recursive: true });
  const light = await openBrowser({ width: 1440, height: 1000, scale: SCALE });
  browsers.push(light);
  const page = await light.context.newPage();
  await page.goto(daemon.url);
  await page.getByRole('button', { name: 'Start scan' }).waitFor();
  await fillScan(page, { sample: 'traced polymer', grid: 'full' });
  await page.getByRole('button', { name: 'Start scan' }).click();
  await doSteps(page, completed(page), 200_000);
  await fitted(page, 200_000);
  await openView(page, 'Result');
  await page.getByRole('button', { name: 'sawtooth', exact: true }).waitFor({ timeout: 60_000 });
  await page.mouse.move(700, 20);
  await page.waitForTimeout(500);
  await page.screenshot({ path: join(DOCS, 'screenshot.png') });

  const dark = await openBrowser({ width: 1440, height: 1000, scale: SCALE, dark: true });
  browsers.push(dark);
  const night = await dark.context.newPage();
  await night.goto(`${daemon.url}/#/result`);
  await openPart(night, 'Uncertainty');
  await night.getByTestId('parameters').waitFor({ timeout: 60_000 });
  await night.waitForTimeout(500);
  await night.screenshot({ path: join(DOCS, 'screenshot-dark.png') });
  expect(await night.getByTestId('parameters').isVisible()).toBe(true);
});

it('makes the picture of the virtual ellipsometer', async () => {
  const light = await openBrowser({ width: 1440, height: 1000, scale: SCALE });
  browsers.push(light);
  const page = await light.context.newPage();
  await page.goto(`${daemon.url}/#/lab`);
  const card = page.getByTestId('traces');
  await card.getByTestId('trace-form').getByLabel('Photons').fill('1e6');
  await card.getByRole('button', { name: 'Trace', exact: true }).click();
  await card.getByTestId('plane-curves').waitFor({ timeout: 200_000 });
  await card.getByRole('button', { name: 'Mueller' }).click();
  await card.locator('[data-component=m12]').click();
  await card.getByRole('heading', { name: 'Directions of the outgoing light' }).evaluate((e) => scrollTo(0, e.getBoundingClientRect().top + scrollY - 90));
  const disc = await card.getByTestId('hemisphere').boundingBox();
  await page.mouse.move((disc?.x ?? 0) + 0.8 * (disc?.width ?? 0), (disc?.y ?? 0) + 0.38 * (disc?.height ?? 0));
  await page.waitForTimeout(300);
  await page.screenshot({ path: join(DOCS, 'screenshot-ellipsometer.png') });
});
