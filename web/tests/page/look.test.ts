// Long names, and the theme.

import { describe, expect, it } from 'vitest';

import { daemon, page, url } from './stage';

describe('a long name without a blank', () => {
  it.each([1280, 400])('makes nothing wider than a screen of %i pixels', async (width) => {
    const surface = { theta_r_deg: 12, alpha_u: 0.1, alpha_v: 0.1, rho_d: 0.2 };
    const scan = daemon.addScan(daemon.addSample(`part_${'0123456789'.repeat(12)}`, surface), 'full');
    daemon.addFit(scan);
    daemon.addFit(scan, 'paper');
    await page.setViewportSize({ width, height: 900 });
    for (const view of ['measure', 'records', 'result', 'result/1/fits']) {
      await page.goto(`${url}/#/${view}`);
      await page.locator('h1, a').getByText('part_0123').first().waitFor();
      expect(await page.evaluate(() => document.documentElement.scrollWidth - innerWidth), view).toBeLessThanOrEqual(0);
    }
    await page.getByTestId('fits').waitFor();
    // The status of a fit, the last column, is visible.
    const [chip, list] = await page.getByTestId('fits').evaluate((table) => [table.querySelector('td .chip')?.getBoundingClientRect().right, table.parentElement?.getBoundingClientRect().right]);
    expect(chip ?? 1e9).toBeLessThanOrEqual(list ?? 0);
    const hidden = await page.getByTestId('fits').evaluate((table) => (table.parentElement?.scrollWidth ?? 1e9) - (table.parentElement?.clientWidth ?? 0));
    if (width === 1280) expect(hidden).toBeLessThanOrEqual(0);
  });
});

describe('the theme', () => {
  it('is switched by hand and remembered', async () => {
    await page.goto(url);
    await page.getByRole('button', { name: 'Use the dark theme' }).click();
    await page.reload();
    expect(await page.evaluate(() => document.documentElement.dataset['theme'])).toBe('dark');
    await page.getByRole('button', { name: 'Use the light theme' }).click();
  });
});
