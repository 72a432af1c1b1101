// The documents that the program carries: every card links to the part of them that explains it.

import { existsSync, readFileSync } from 'node:fs';
import { join } from 'node:path';

import { describe, expect, it } from 'vitest';

import { axeViolations, daemon, fill, open, page, url, VIEWS } from './stage';

const DIST = join(import.meta.dirname, '../../dist');

/** Whether a link of the page leads to a built document and, with an anchor, to a place in it. */
function resolves(href: string): boolean {
  const [path = '', anchor] = href.split('#');
  const file = join(DIST, path);
  return existsSync(file) && (anchor === undefined || readFileSync(file, 'utf8').includes(` id="${anchor}"`));
}

describe('the help', () => {
  it('is one link in every card of every view, named after the card, to a place that exists', async () => {
    fill();
    daemon.certainties.push({ id: 1, elapsed_s: 9, n_observations: 1, n_frames_used: 1, variant: 'sawtooth', status: 'converged', parameters: {} });
    const met = new Set<string>();
    for (const [view, words] of VIEWS) {
      await open(view, words);
      const cards = page.locator('main .card[aria-labelledby]:visible');
      for (const card of await cards.all()) {
        const title = (await page.locator(`[id="${await card.getAttribute('aria-labelledby')}"]`).innerText()).replace(/\s+/g, ' ').trim();
        const links = card.locator('a.help');
        expect(await links.count(), `${view}: ${title}`).toBe(1);
        const href = (await links.getAttribute('href')) ?? '';
        expect(resolves(href), `${view}: ${title}: ${href}`).toBe(true);
        expect(await links.getAttribute('target')).toBe('_blank');
        met.add(title);
      }
      // A card without a title is a notice, not a card with something to explain.
      expect(await page.locator('main section.card:visible:not([aria-labelledby], [role=alert], [aria-busy=true])').count(), view).toBe(0);
    }
    expect(met.size).toBeGreaterThan(30);
    await open('measure', 'Last results');
    await expect.poll(() => page.getByRole('link', { name: 'Help: Last results', exact: true }).count()).toBe(1);
  });

  it('opens beside the page, is readable on a phone, and has no violation of axe-core', async () => {
    await page.setViewportSize({ width: 320, height: 640 });
    for (const path of ['index', 'reference/page', 'reference/glossary', 'how-to/queue']) {
      for (const colorScheme of ['light', 'dark'] as const) {
        await page.emulateMedia({ colorScheme });
        await page.goto(`${url}/docs/${path}.html`);
        expect(await page.getByRole('heading', { level: 1 }).count(), path).toBe(1);
        expect(await page.evaluate(() => getComputedStyle(document.body).backgroundColor), path).toBe(colorScheme === 'dark' ? 'rgb(13, 17, 22)' : 'rgb(255, 255, 255)');
        expect(await page.evaluate(() => document.documentElement.scrollWidth - innerWidth), path).toBeLessThanOrEqual(0);
        expect(await axeViolations(), path).toEqual([]);
      }
    }
  });
});
