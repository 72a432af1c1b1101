// What a printed page shows: the paper has no buttons, but it keeps their words where these name what is shown.

import { describe, expect, it } from 'vitest';

import { daemon, page, url } from './stage';

/** Text width of a sheet of A4 in CSS pixels. */
const SHEET_PX = 720;

async function print(): Promise<void> {
  await page.emulateMedia({ media: 'print' });
  await page.setViewportSize({ width: SHEET_PX, height: 1000 });
}

describe('on paper', () => {
  it('every curve of a result has its tilt and the key of its colours', async () => {
    daemon.addFit(daemon.addScan(1, 'full'));
    await page.goto(`${url}/#/result/1`);
    await page.getByRole('button', { name: 'sawtooth', exact: true }).waitFor();
    await print();
    const titles = page.getByTestId('curves').locator('figcaption');
    expect((await titles.allInnerTexts()).map((t) => t.replace(/\s+/g, ' ').trim())).toEqual(['−20°', '−15°', '−10°', '−5°', '0°', '5°', '10°', '15°', '20°'].map((tilt) => expect.stringContaining(tilt)));
    await expect.poll(() => titles.locator('button:visible').count()).toBe(9);
    expect(await page.getByRole('button', { name: 'sawtooth', exact: true }).isVisible()).toBe(true);
    for (const name of [/STOP/, /^Fit/, 'Repeat']) expect(await page.getByRole('button', { name }).count()).toBe(0);
  });

  it('the budgets of a result are drawn', async () => {
    daemon.addFit(daemon.addScan(1, 'full'));
    await page.goto(`${url}/#/result/1/uncertainty`);
    await page.getByTestId('parameters').waitFor();
    await print();
    expect(await page.getByRole('button', { name: /^Budget of the ridge angle/ }).isVisible()).toBe(true);
  });

  it('the records have all their columns with their heads, and no word of a field that is not there', async () => {
    daemon.recipes.add({ name: 'PX-1204 rev C', plan: { preset: 'paper' }, target_expanded_deg: 0.05 });
    daemon.specifications.add({ name: 'drawing 7', limits: { theta_r_deg: { lower: 9, upper: 10.1 } } });
    for (let i = 0; i < 3; i++) daemon.addPart(1, 'PX-1204 rev C', 'drawing 7');
    await page.goto(`${url}/#/records`);
    const table = page.getByTestId('scans');
    await table.locator('tbody tr').nth(2).waitFor();
    await print();
    for (const head of ['Scan', 'Part', 'Verdict', 'External no.', 'Lot', 'Recipe', 'State', 'When', 'Operator']) {
      const shown = table.getByRole('columnheader', { name: head, exact: true });
      expect((await shown.innerText()).replace(/[▲▼\s]+$/u, '').trim(), head).toBe(head);
      const box = await shown.boundingBox();
      expect((box?.x ?? 1e9) + (box?.width ?? 0), `${head} is cut`).toBeLessThanOrEqual(SHEET_PX);
    }
    for (const label of ['Search', 'More filters', 'newest of each part', 'Import a series']) expect(await page.getByText(label, { exact: true }).isVisible(), label).toBe(false);
    expect(await page.evaluate(() => document.documentElement.scrollWidth - innerWidth)).toBeLessThanOrEqual(0);
  });

  it('no view has the label of a field without its field', async () => {
    daemon.addFit(daemon.addScan(1, 'full'));
    for (const [view, words] of [['measure', 'Last results'], ['result/1/verdict', 'Ridge angle'], ['result/1/record', 'Models tried'], ['chart', 'Values, newest first'], ['rig', 'Axes by hand'], ['lab', 'Virtual ellipsometer'], ['setup', 'Look of the page']] as const) {
      await page.emulateMedia({ media: 'screen' });
      await page.goto(`${url}/#/${view}`);
      await page.locator('main').getByText(words, { exact: false }).first().waitFor();
      await print();
      const orphans = await page.evaluate(() => [...document.querySelectorAll('label')].filter((label) => label.checkVisibility() && label.control !== null && !label.control.checkVisibility()).map((label) => label.innerText));
      expect(orphans, view).toEqual([]);
    }
  });
});
