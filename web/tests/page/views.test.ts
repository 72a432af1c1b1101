// The page with a mock daemon: its views, their addresses, their size, and rules that hold in every view.

import { readFile } from 'node:fs/promises';
import { join } from 'node:path';
import { gzipSync } from 'node:zlib';

import { describe, expect, it } from 'vitest';

import { axeViolations, chooseSample, daemon, fill, layoutShift, open, page, text, url, VIEWS, watchLayout } from './stage';

const DIST = join(import.meta.dirname, '../../dist');

/** A row of the fit during a scan. */
const certainty = (id: number) => ({ id, elapsed_s: 9 * id, n_observations: id, n_frames_used: id, variant: 'sawtooth', status: 'converged', parameters: { theta_r_deg: { value: 10, std: 0.3 / id } } });

/** Bytes of script and style that the page has requested so far, as the daemon sends them. */
async function loaded(): Promise<{ names: string[]; bytes: number }> {
  const names = await page.evaluate(() => performance.getEntriesByType('resource').map((r) => new URL(r.name).pathname).filter((name) => /\.(js|css)$/.test(name)));
  const files = await Promise.all([...new Set(names)].map((name) => readFile(join(DIST, name))));
  return { names, bytes: files.reduce((sum, file) => sum + gzipSync(file, { level: 6 }).length, 0) };
}

describe('the first view', () => {
  it('needs less than 60 kB of script and style, and nothing of the other views', async () => {
    daemon.addFit(daemon.addScan(1, 'full'));
    await open('', 'Last results');
    await chooseSample();
    await page.getByText(/\d+ frames/).first().waitFor();
    const first = await loaded();
    expect(first.bytes).toBeLessThan(60_000);
    expect(first.names.filter((name) => /plot|LabView|ResultView|RigView|Trace/.test(name))).toEqual([]);
    await open('lab', 'Virtual ellipsometer');
    expect((await loaded()).names.some((name) => name.includes('LabView'))).toBe(true);
  });
});

describe('a part of the page that did not arrive', () => {
  it('has its styles when it is opened again', async () => {
    fill();
    await open('', 'Last results');
    await page.route('**/ChartView*.css', (route) => route.abort());
    await page.goto(`${url}/#/chart`);
    await page.getByText('Control chart could not be opened').waitFor();
    await page.unroute('**/ChartView*.css');
    await open('records', 'Search');
    await open('chart', 'Values, newest first');
    const rules = (): Promise<number> => page.evaluate(() => [...document.styleSheets].filter((sheet) => sheet.href?.includes('/ChartView')).reduce((n, sheet) => n + sheet.cssRules.length, 0));
    await expect.poll(rules, { timeout: 10_000 }).toBeGreaterThan(0);
  });
});

describe('a list that could not be read while the link was lost', () => {
  it('is read by itself once the link is live again', async () => {
    fill();
    await open('', 'Last results');
    await page.route('**/api/v1/**', (route) => route.abort());
    daemon.dropStreams();
    await page.getByText('The daemon cannot be reached.').waitFor();
    // The script of the view comes, its list does not.
    await page.goto(`${url}/#/records`);
    await page.getByText('The records cannot be read.').waitFor();
    await page.unroute('**/api/v1/**');
    await page.getByTestId('read-again').waitFor({ state: 'detached' });
    await page.getByText('2 results').waitFor();
  });
});

describe('the address', () => {
  it('keeps view, scan, fit and part over a reload and the back button, also in its earlier form', async () => {
    daemon.addFit(daemon.addScan(1, 'full'), 'paper');
    daemon.addFit(daemon.addScan(2, 'paper'));
    await page.goto(`${url}/#/scan/1/fit/1`);
    await expect.poll(() => text('[data-parameter=theta_r_deg]')).toBe('10.61 ± 0.42°');
    await page.getByRole('navigation', { name: 'Parts of the result' }).getByRole('link', { name: 'Uncertainty' }).click();
    await page.getByTestId('parameters').waitFor();
    expect(new URL(page.url()).hash).toBe('#/result/1/fit/1/uncertainty');
    await page.reload();
    await page.getByTestId('parameters').waitFor();
    const views = page.getByRole('navigation', { name: 'Views' });
    await views.getByRole('link', { name: 'Rig' }).click();
    await page.getByRole('heading', { name: 'Axes by hand' }).waitFor();
    expect(await views.locator('[aria-current=page]').innerText()).toBe('Rig');
    await page.goBack();
    await page.getByTestId('parameters').waitFor();
    await views.getByRole('link', { name: 'Result' }).click();
    await expect.poll(() => text('#answer-title')).toBe('model 15°');
    await views.getByRole('link', { name: 'Set-up' }).click();
    await page.getByTestId('samples').getByText('traced polymer').waitFor();
  });
});

describe('every view', () => {
  it('shows what a refusal quotes as code, not between backticks, and reads again when it is asked to', async () => {
    fill();
    const body = { status: 503, code: 'store-failed', title: 'the database cannot be read', detail: 'the database cannot be read: `ridged doctor` states the cause' };
    for (const [view, path] of [
      ['records', '/results'], ['chart', '/charts'], ['compare/1,2', '/comparisons'], ['repeat/1,2', '/repeatability'], ['setup', '/calibrations'],
      ['result/1', '/fits/1/curve'], ['result/1/frames', '/scans/1/frames'], ['result/1/map', '/maps'], ['result/1/verdict', '/verdicts'], ['lab', '/traces'],
    ] as const) {
      daemon.refusals.clear();
      daemon.refusals.set(`GET ${path}`, { status: 503, body });
      await page.goto(`${url}/#/${view}`);
      await page.reload();
      await page.getByText('The database cannot be read', { exact: false }).first().waitFor();
      expect(await page.locator('main code').getByText('ridged doctor', { exact: true }).count(), view).toBeGreaterThan(0);
      expect(await text('body'), view).not.toContain('`');
      // It is read again by its button. The curves have a place of their own for it.
      daemon.refusals.clear();
      if (view === 'result/1') continue;
      await page.getByTestId('read-again').getByRole('button', { name: 'Read again' }).click();
      await page.getByTestId('read-again').waitFor({ state: 'detached' });
    }
  });

  it('has no violation of axe-core, in light and dark, and no console error', async () => {
    daemon.certainties.push(...[1, 2, 3].map(certainty));
    fill();
    const errors: string[] = [];
    page.on('console', (message) => message.type() === 'error' && errors.push(message.text()));
    const found: string[] = [];
    const look = async (state: string): Promise<void> => {
      for (const dark of [false, true]) {
        await page.evaluate((on) => (document.documentElement.dataset['theme'] = on ? 'dark' : 'light'), dark);
        const violations = await axeViolations();
        found.push(...violations.map((v) => `${state} ${dark ? 'dark' : 'light'} ${v}`));
      }
    };
    for (const [view, words] of VIEWS) {
      await open(view, words);
      await look(view);
    }
    // The forms of the set-up, with faults, and a history.
    await page.getByRole('button', { name: 'New recipe' }).click();
    await page.getByRole('button', { name: 'Save the recipe' }).click();
    await page.getByRole('button', { name: 'New specification' }).click();
    await page.getByRole('button', { name: 'Save the specification' }).click();
    await page.getByRole('button', { name: 'History of PX-1204' }).click();
    await page.getByTestId('history').getByText('first version').waitFor();
    await look('setup, forms');
    expect(await page.evaluate(() => document.documentElement.scrollWidth - innerWidth)).toBeLessThanOrEqual(0);
    expect(found).toEqual([]);
    expect(errors).toEqual([]);
  });

  it.each([320, 1440])('fits a window of %i pixels and does not jump while it is read', async (width) => {
    fill();
    await page.setViewportSize({ width, height: width === 320 ? 640 : 900 });
    await watchLayout();
    for (const [view, words] of VIEWS) {
      await page.goto('about:blank');
      await open(view, words);
      await page.waitForTimeout(150);
      expect(await page.evaluate(() => document.documentElement.scrollWidth - innerWidth), `${view} is wider than the window`).toBeLessThanOrEqual(0);
      const { shift, moved } = await layoutShift();
      expect(shift, `layout shift of ${view}: ${moved.join(', ')}`).toBeLessThan(0.1);
      const stop = await page.getByRole('button', { name: /STOP/ }).boundingBox();
      expect((stop?.x ?? 1e9) + (stop?.width ?? 0)).toBeLessThanOrEqual(width);
    }
  });

  it.each([390, 1440])('does not jump from the start of a scan to its verdict in a window of %i pixels', async (width) => {
    daemon.recipes.add({ name: 'PX-1204', plan: { preset: 'paper' }, target_expanded_deg: 0.05 });
    daemon.specifications.add({ name: 'drawing 7', limits: { theta_r_deg: { lower: 9, upper: 11 } } });
    daemon.frameMs = 40;
    daemon.fitMs = 800;
    await page.setViewportSize({ width, height: width === 390 ? 844 : 1000 });
    await watchLayout();
    await page.goto(url);
    await chooseSample();
    await page.getByRole('combobox', { name: 'Recipe' }).selectOption('PX-1204');
    await page.getByRole('combobox', { name: 'Specification' }).selectOption('drawing 7');
    await page.getByText('53 frames').waitFor();
    await page.getByRole('button', { name: 'Start scan' }).click();
    for (let i = 0; i < 3; i++) await page.getByRole('button', { name: 'Continue' }).click();
    await page.getByTestId('newest-frame').locator('canvas').waitFor();
    for (const id of [1, 2, 3, 4]) {
      // Far from the last press, so that every jump counts.
      await page.waitForTimeout(250);
      daemon.event('uncertainty', { ...certainty(id), scan_id: 1 });
    }
    await page.getByTestId('so-far').waitFor();
    await page.getByText('completed', { exact: true }).waitFor();
    const fit = await fetch(`${url}/api/v1/fits`, { method: 'POST', headers: { 'content-type': 'application/json' }, body: JSON.stringify({ scan_id: 1, variant: 'auto' }) });
    expect(fit.status).toBe(202);
    daemon.event('fit', { fit_id: 1, scan_id: 1, state: 'running' });
    await page.getByTestId('forecast').waitFor();
    await page.getByTestId('verdict-banner').getByText('pass').waitFor();
    await page.getByRole('button', { name: 'sawtooth', exact: true }).waitFor();
    await page.waitForTimeout(300);
    const { shift, moved } = await layoutShift();
    expect(shift, moved.join(', ')).toBeLessThan(0.1);
  });

  it('is reached and used by keys only', async () => {
    daemon.addFit(daemon.addScan(1, 'paper'));
    await open('measure', 'Last results');
    await page.keyboard.press('Tab');
    expect(await page.evaluate(() => document.activeElement?.textContent)).toBe('To the content');
    const views = page.getByRole('navigation', { name: 'Views' });
    await views.getByRole('link', { name: 'Records' }).focus();
    await page.keyboard.press('Enter');
    await page.getByTestId('records').waitFor();
    await expect.poll(() => page.evaluate(() => document.activeElement?.id)).toBe('main');
    // The first stops of the Tab key in the view: the help of the card, then the search.
    await page.keyboard.press('Tab');
    expect(await page.evaluate(() => document.activeElement?.getAttribute('href'))).toBe('docs/how-to/results.html');
    await page.keyboard.press('Tab');
    await page.keyboard.type('no such part');
    await page.getByText('No scan matches these filters.').waitFor();
  });
});
