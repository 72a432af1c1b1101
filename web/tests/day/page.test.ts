// A day at the rig on the page: recipe and specification, the parts of a CSV file one by one, the queue, and a row for each part at the
// end. It uses the daemon at RIDGED_URL, reads the parts from DAY_PARTS_CSV and writes the rows to DAY_ROWS_CSV; `tests/day/run` sets them.

import { readFileSync } from 'node:fs';

import type { Page } from 'playwright-core';
import { afterAll, beforeAll, expect, it } from 'vitest';

import { openBrowser, type OpenBrowser } from '../browser';
import { addSample, doSteps, fillPart, openView, saveSpecification } from '../operate';

/** A part with a debug binary on a busy machine, from its form to its verdict. */
const PART_MS_MAX = 90_000;
const RECIPE = 'PX-1204 rev C';
const SPECIFICATION = 'drawing 4711 B';

function given(name: string): string {
  const value = process.env[name];
  if (value === undefined) throw new Error(`${name} is not set; tests/day/run sets it`);
  return value;
}

const parts = readFileSync(given('DAY_PARTS_CSV'), 'utf8').trim().split(/\r?\n/).slice(1).map((line) => {
  const [part = '', lot = '', externalId = ''] = line.split(',');
  return { part, lot, externalId };
});

let browser: OpenBrowser;
let page: Page;
const faults: string[] = [];

beforeAll(async () => {
  browser = await openBrowser();
  page = await browser.context.newPage();
  page.on('pageerror', (error) => faults.push(error.message));
  page.on('console', (message) => {
    if (message.type() === 'error') faults.push(`${message.text()} ${message.location().url}`);
  });
});
afterAll(async () => {
  await browser?.close();
});

async function saveRecipe(): Promise<void> {
  await page.getByRole('button', { name: 'New recipe' }).click();
  const form = page.getByTestId('recipe-form');
  await form.getByLabel(/^Name/).fill(RECIPE);
  await form.getByText('quick', { exact: true }).click();
  await form.getByRole('combobox', { name: 'Model' }).selectOption('sawtooth');
  await form.getByRole('combobox', { name: 'Material' }).selectOption('dielectric');
  await form.getByLabel(/^n, /).fill('1.54');
  await form.getByLabel(/^u of n/).fill('0.005');
  await form.getByRole('button', { name: 'Save the recipe' }).click();
  await page.getByRole('button', { name: `Change ${RECIPE}` }).waitFor();
}

it('measures the parts of a day', async () => {
  await page.goto(given('RIDGED_URL'));
  await page.getByRole('button', { name: 'Start scan' }).waitFor();
  await openView(page, 'Set-up');
  await saveRecipe();
  await saveSpecification(page, SPECIFICATION, '9', '11');

  await openView(page, 'Measure');
  const queue = page.getByTestId('queue');
  for (const [place, { part, lot, externalId }] of parts.entries()) {
    const known = await page.getByRole('combobox', { name: /^Part/ }).locator('option', { hasText: `${part} (` }).count();
    if (known === 0) await addSample(page, part);
    await fillPart(page, { sample: part, recipe: RECIPE, specification: SPECIFICATION, lot, externalId });
    await page.getByRole('button', { name: 'Add to queue' }).click();
    await queue.locator('li').nth(place).getByText(part, { exact: true }).waitFor();
  }
  await queue.getByRole('button', { name: 'Start the queue' }).click();
  await queue.getByRole('button', { name: 'Stop after this one' }).waitFor();
  const steps = await doSteps(page, async () => (await queue.getByText('all orders are done').count()) > 0, parts.length * PART_MS_MAX);
  expect(steps).toEqual(['Cap the lens', 'Place the white reference', ...parts.map(({ part }) => `Place the part ${part}`)]);

  await openView(page, 'Records');
  const rows = page.getByTestId('scans').locator('tbody tr');
  const judged = rows.filter({ has: page.locator('.chip', { hasText: /^(pass|fail|cannot tell)$/ }) });
  await expect.poll(() => judged.count(), { timeout: parts.length * PART_MS_MAX }).toBe(parts.length);
  // The first press puts the newest scan in front.
  const scans = page.getByRole('columnheader', { name: 'Scan', exact: true });
  for (let press = 0; press < 3 && (await scans.getAttribute('aria-sort')) !== 'ascending'; press += 1) await scans.getByRole('button').click();
  await expect.poll(() => rows.locator('th').allInnerTexts()).toEqual(parts.map(({ part }) => part));
  const download = page.waitForEvent('download');
  await page.getByTestId('records-csv').click();
  await (await download).saveAs(given('DAY_ROWS_CSV'));
  expect(faults).toEqual([]);
}, (2 * parts.length + 1) * PART_MS_MAX);
