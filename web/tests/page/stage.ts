// The page in a real browser against the mock daemon, for situations that are hard to produce with a real one. Each test file
// that imports this one has its own browser, and each test its own page and daemon.

import { existsSync } from 'node:fs';
import { createRequire } from 'node:module';
import { join } from 'node:path';

import type { Page } from 'playwright-core';
import { afterAll, afterEach, beforeAll, beforeEach, expect } from 'vitest';

import { openBrowser, type OpenBrowser } from '../browser';
import { MockDaemon } from '../mock/server';

const AXE = createRequire(import.meta.url).resolve('axe-core/axe.min.js');
const DIST = join(import.meta.dirname, '../../dist');

export let browser: OpenBrowser;
export let daemon: MockDaemon;
export let url: string;
export let page: Page;
let faults: string[];

beforeAll(async () => {
  if (!existsSync(join(DIST, 'index.html'))) throw new Error('the page is not built: npm run build');
  browser = await openBrowser();
});
afterAll(async () => browser.close());

beforeEach(async () => {
  url = await anotherDaemon().start();
  page = await browser.context.newPage();
  faults = [];
  page.on('pageerror', (error) => faults.push(error.message));
});
afterEach(async () => {
  await page.close();
  await daemon.stop();
  expect(faults).toEqual([]);
});

/** Replaces the daemon. */
export function anotherDaemon(): MockDaemon {
  daemon = new MockDaemon({ dist: DIST, frameMs: 5 });
  return daemon;
}

/** Requests to the daemon, without estimates. */
export const posts = (): string[] => daemon.requests.map((r) => r.path).filter((p) => p !== '/scans/estimate');

/** Chooses a part in the form of a new scan: before the first scan there is none. */
export async function chooseSample(label = 'traced polymer (n 1.54)'): Promise<void> {
  await page.getByRole('combobox', { name: /^Part/ }).selectOption({ label });
}

export async function text(selector: string): Promise<string> {
  return (await page.locator(selector).innerText()).replace(/\s+/g, ' ').trim();
}

/** What axe-core finds in the page as it is now. */
export async function axeViolations(): Promise<string[]> {
  if ((await page.evaluate(() => 'axe' in window)) === false) await page.addScriptTag({ path: AXE });
  return page.evaluate(async () => {
    const { axe } = window as unknown as { axe: { run(options: object): Promise<{ violations: { id: string; nodes: { html: string; failureSummary: string }[] }[] }> } };
    const { violations } = await axe.run({ resultTypes: ['violations'] });
    return violations.map((v) => `${v.id}: ${v.nodes.map((n) => `${n.html.slice(0, 160)} ${n.failureSummary}`).join('\n')}`);
  });
}

/** Records in every page that is opened from now on how far its layout moves without an input of the user. */
export async function watchLayout(): Promise<void> {
  await page.addInitScript(() => {
    const shifts = window as unknown as { shift: number; moved: string[] };
    [shifts.shift, shifts.moved] = [0, []];
    new PerformanceObserver((list) => {
      for (const entry of list.getEntries() as unknown as { value: number; hadRecentInput: boolean; sources: { node: Element | null; previousRect: DOMRect; currentRect: DOMRect }[] }[]) {
        if (entry.hadRecentInput) continue;
        shifts.shift += entry.value;
        const where = ({ x, y, width, height }: DOMRect): string => [x, y, width, height].map(Math.round).join(' ');
        shifts.moved.push(...entry.sources.map(({ node, previousRect, currentRect }) => `${entry.value.toFixed(3)} ${node?.nodeName ?? ''}.${node?.className ?? ''} “${node?.textContent?.trim().slice(0, 30)}” ${where(previousRect)} → ${where(currentRect)}`));
      }
    }).observe({ type: 'layout-shift', buffered: true });
  });
}

/** The sum of the layout shifts so far, and what moved. */
export async function layoutShift(): Promise<{ shift: number; moved: string[] }> {
  return page.evaluate(() => { const { shift, moved } = window as unknown as { shift: number; moved: string[] }; return { shift, moved }; });
}

/** Views and a text of each that shows that it is there. */
export const VIEWS: readonly (readonly [string, string])[] = [
  ['measure', 'Last results'],
  ['result/1', 'BRDF × cos'],
  ['result/1/uncertainty', 'Share of the variance'],
  ['result/1/verdict', 'Ridge angle'],
  ['result/1/map', 'The fit of every pixel'],
  ['result/1/contrast', 'turned by 90°'],
  ['result/1/frames', 'automatic levels'],
  ['result/1/record', 'Models tried'],
  ['result/1/fits', 'of all scans'],
  ['records', 'Search'],
  ['compare/1,2', 'open dots'],
  ['repeat/1,2', 'Scatter s'],
  ['chart', 'Values, newest first'],
  ['rig', 'No alarm in the newest scans'],
  ['lab', 'Virtual ellipsometer'],
  ['setup', 'Look of the page'],
];

/** A store as a lab has it: recipes, a specification, and two scans of which one cannot be decided. */
export function fill(): void {
  for (const name of ['PX-1204', 'PX-1205']) daemon.recipes.add({ name, plan: { preset: 'paper' }, target_expanded_deg: 0.05 });
  daemon.specifications.add({ name: 'drawing 7', limits: { theta_r_deg: { lower: 9, upper: 10.1 } } });
  daemon.addPart(1, 'PX-1204', 'drawing 7');
  daemon.addFit(daemon.addScan(1, 'full'));
}

/** Opens a view, and waits for a text of it. */
export async function open(view: string, words: string): Promise<void> {
  await page.goto(`${url}/#/${view}`);
  await page.locator('main').getByText(words, { exact: false }).first().waitFor();
}
