// The page alone, in a real browser, against the mock daemon: what is hard to bring about on a real one. Each file of tests
// that names this one has a browser of its own, and each test its own page and daemon.

import { existsSync } from 'node:fs';
import { join } from 'node:path';

import type { Page } from 'playwright-core';
import { afterAll, afterEach, beforeAll, beforeEach, expect } from 'vitest';

import { openBrowser, type OpenBrowser } from '../browser';
import { MockDaemon } from '../mock/server';

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

/** Takes the place of the daemon there was. */
export function anotherDaemon(): MockDaemon {
  daemon = new MockDaemon({ dist: DIST, frameMs: 5 });
  return daemon;
}

/** What was asked of the daemon, estimates aside. */
export const posts = (): string[] => daemon.requests.map((r) => r.path).filter((p) => p !== '/scans/estimate');

export async function text(selector: string): Promise<string> {
  return (await page.locator(selector).innerText()).replace(/\s+/g, ' ').trim();
}
