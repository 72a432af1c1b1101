// Actions of a user at the page, for the tests with the real daemon.

import type { Page } from 'playwright-core';

interface GridChoice {
  readonly sample: string;
  readonly grid: 'paper' | 'full' | 'custom';
  readonly tilts?: string;
  readonly azimuths?: string;
}

/** Opens a view by its link in the bar. */
export async function openView(page: Page, name: 'Measure' | 'Result' | 'Records' | 'Rig' | 'Lab' | 'Set-up'): Promise<void> {
  await page.getByRole('navigation', { name: 'Views' }).getByRole('link', { name }).click();
}

/** Opens a part of the shown result. */
export async function openPart(page: Page, name: string): Promise<void> {
  await page.getByRole('navigation', { name: 'Parts of the result' }).getByRole('link', { name, exact: true }).click();
}

interface PartChoice {
  readonly sample: string;
  readonly recipe: string;
  readonly specification: string;
  readonly lot: string;
  readonly externalId?: string;
}

/** Saves a specification with limits of the ridge angle, in *Set-up*. */
export async function saveSpecification(page: Page, name: string, lowerDeg: string, upperDeg: string): Promise<void> {
  await page.getByRole('button', { name: 'New specification' }).click();
  const form = page.getByTestId('specification-form');
  await form.getByLabel(/^Name/).fill(name);
  await form.getByLabel('ridge angle: lower limit').fill(lowerDeg);
  await form.getByLabel('ridge angle: upper limit').fill(upperDeg);
  await form.getByRole('button', { name: 'Save the specification' }).click();
  await page.getByRole('button', { name: `Change ${name}` }).waitFor();
}

/** Adds a part with the material that the form proposes, in the form of the next part. */
export async function addSample(page: Page, name: string): Promise<void> {
  await page.getByRole('combobox', { name: /^Part/ }).selectOption({ label: 'New part …' });
  const form = page.getByTestId('sample-form');
  await form.getByLabel('Name', { exact: true }).fill(name);
  await form.getByRole('button', { name: 'Add part' }).click();
  await form.waitFor({ state: 'detached' });
}

async function chooseSample(page: Page, name: string): Promise<void> {
  const samples = page.getByRole('combobox', { name: /^Part/ });
  // The index follows the name.
  const option = samples.locator('option', { hasText: `${name} (` }).first();
  await option.waitFor({ state: 'attached' });
  await samples.selectOption({ label: await option.innerText() });
}

/** Fills in the form of the next part with a recipe and a specification. */
export async function fillPart(page: Page, choice: PartChoice): Promise<void> {
  await chooseSample(page, choice.sample);
  await page.getByRole('combobox', { name: 'Recipe' }).selectOption(choice.recipe);
  await page.getByRole('combobox', { name: 'Specification' }).selectOption(choice.specification);
  await page.getByLabel('Lot').fill(choice.lot);
  if (choice.externalId !== undefined) await page.getByLabel('External number').fill(choice.externalId);
}

/** Fills in the form of the next part with a grid of its own. */
export async function fillScan(page: Page, choice: GridChoice): Promise<void> {
  await chooseSample(page, choice.sample);
  const recipes = page.getByRole('combobox', { name: 'Recipe' });
  if ((await recipes.count()) > 0) await recipes.selectOption('own grid …');
  await page.locator('.grids').getByText(choice.grid === 'paper' ? 'quick' : choice.grid, { exact: true }).click();
  if (choice.tilts !== undefined) await page.getByLabel(/Camera tilts/).fill(choice.tilts);
  if (choice.azimuths !== undefined) await page.getByLabel(/Sample azimuths/).fill(choice.azimuths);
}

/** Confirms each operator step until `until` holds; returns the headings of the steps. */
export async function doSteps(page: Page, until: () => Promise<boolean>, timeoutMs: number): Promise<string[]> {
  const steps: string[] = [];
  const proceed = page.getByRole('button', { name: 'Continue' });
  const deadline = Date.now() + timeoutMs;
  while (!(await until())) {
    if (Date.now() > deadline) throw new Error(`not done after ${timeoutMs} ms; steps so far: ${steps.join(', ') || 'none'}`);
    if ((await proceed.count()) > 0 && (await proceed.isEnabled())) {
      const heading = await page.locator('section.call h2').innerText();
      await proceed.click();
      steps.push(heading);
      await page.locator('section.call h2', { hasText: heading }).waitFor({ state: 'detached' });
    }
    await page.waitForTimeout(100);
  }
  return steps;
}

/** Whether the shown scan has ended. */
export function completed(page: Page): () => Promise<boolean> {
  return async () => (await page.locator('section[aria-labelledby=answer-title] .card-head .chip', { hasText: 'completed' }).count()) > 0;
}

/** Reads a headline number once the fit that follows a completed scan is shown. */
export async function fitted(page: Page, timeoutMs: number): Promise<{ theta_r_deg: number; text: string }> {
  const place = page.locator('[data-parameter=theta_r_deg]');
  await place.waitFor({ timeout: timeoutMs });
  const text = (await place.innerText()).replace(/\s+/g, ' ').trim();
  return { theta_r_deg: Number.parseFloat(text.replace('−', '-')), text };
}
