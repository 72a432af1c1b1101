// The bar over all views at the widths of phones, tablets and laptops, with and without a user.

import { describe, expect, it } from 'vitest';

import { daemon, page, url } from './stage';

const WIDTHS_PX = [320, 360, 390, 761, 768, 820, 940, 1024, 1200, 1280, 1440, 1600, 1920];
const LONG_NAME = 'maria-magdalena.schneider-hohenstein-x';

/** What is wrong with the bar: a part that is cut off, covered or out of the window, and a state of more than two lines. */
async function barFaults(): Promise<string[]> {
  return page.evaluate(() => {
    const faults: string[] = [];
    const width = document.documentElement.clientWidth;
    if (document.documentElement.scrollWidth > width) faults.push(`the page is ${document.documentElement.scrollWidth} px wide`);
    for (const part of document.querySelectorAll('header :is(a, button)')) {
      const name = part.textContent?.trim() || part.getAttribute('aria-label');
      const box = part.getBoundingClientRect();
      if (box.left < 0 || box.right > width) faults.push(`${name} ends at ${Math.round(box.right)} px`);
      for (const [x, y] of [[box.left + 3, box.top + box.height / 2], [box.left + box.width / 2, box.top + box.height / 2], [box.right - 3, box.top + box.height / 2]] as const) {
        const top = document.elementFromPoint(x, y);
        if (!part.contains(top)) faults.push(`${name} is below ${top?.nodeName}.${top?.className}`);
      }
    }
    const stop = document.querySelector('header .stop')?.getBoundingClientRect();
    const brand = document.querySelector('header .brand')?.getBoundingClientRect();
    if (!stop || !brand || stop.top > brand.bottom) faults.push('STOP is not in the first row');
    const word = document.querySelector('header .word');
    if (width > 760 && word && word.getBoundingClientRect().height > 2.6 * parseFloat(getComputedStyle(word).fontSize)) faults.push('the state has more than two lines');
    if (word && word.scrollHeight > word.clientHeight + 2) faults.push(`the state is cut off: ${word.textContent}`);
    return faults;
  });
}

describe('the bar', () => {
  it.each([[null], ['eva'], ['maria.schneider'], [LONG_NAME]])('has STOP and all links whole at every width, user: %s', async (who) => {
    if (who !== null) daemon.tokens.set('ridged_x', { who, role: 'operator' });
    await page.goto(`${url}/#/setup`);
    if (who !== null) {
      await page.locator('input[type=password]').fill('ridged_x');
      await page.getByRole('button', { name: 'Log in' }).click();
      await page.locator('header .user').waitFor();
      expect(await page.locator('header .who').getAttribute('title')).toBe(`${who}, role: operator`);
    }
    const found: string[] = [];
    for (const [homed, state] of [[true, 'at rest'], [false, 'position unknown – home the axes']] as const) {
      for (const axis of Object.values(daemon.axes)) axis.referenced = homed;
      daemon.event('rig', {});
      await page.locator('header .word').getByText(state, { exact: true }).waitFor();
      for (const width of WIDTHS_PX) {
        await page.setViewportSize({ width, height: 800 });
        found.push(...(await barFaults()).map((fault) => `${width} px, ${state}: ${fault}`));
        if (process.env['SHOTS'] !== undefined) await page.screenshot({ path: `${process.env['SHOTS']}/bar-${who ?? 'none'}-${width}-${homed ? 'rest' : 'unknown'}.png`, clip: { x: 0, y: 0, width, height: 190 } });
      }
    }
    expect(found).toEqual([]);
  });
});
