// The page alone, in a real browser, against the mock daemon: what is hard to bring about on a real one.

import { existsSync } from 'node:fs';
import { join } from 'node:path';

import type { Page } from 'playwright-core';
import { afterAll, afterEach, beforeAll, beforeEach, describe, expect, it } from 'vitest';

import { openBrowser, type OpenBrowser } from '../browser';
import { MockDaemon } from '../mock/server';

const DIST = join(import.meta.dirname, '../../dist');

let browser: OpenBrowser;
let daemon: MockDaemon;
let url: string;
let page: Page;
let faults: string[];

beforeAll(async () => {
  if (!existsSync(join(DIST, 'index.html'))) throw new Error('the page is not built: npm run build');
  browser = await openBrowser();
});
afterAll(async () => browser.close());

beforeEach(async () => {
  daemon = new MockDaemon({ dist: DIST, frameMs: 5 });
  url = await daemon.start();
  page = await browser.context.newPage();
  faults = [];
  page.on('pageerror', (error) => faults.push(error.message));
});
afterEach(async () => {
  await page.close();
  await daemon.stop();
  expect(faults).toEqual([]);
});

/** What was asked of the daemon, estimates aside. */
const posts = (): string[] => daemon.requests.map((r) => r.path).filter((p) => p !== '/scans/estimate');

async function text(selector: string): Promise<string> {
  return (await page.locator(selector).innerText()).replace(/\s+/g, ' ').trim();
}

describe('stop', () => {
  it('goes out by click and by Escape, from inside a field too', async () => {
    await page.goto(url);
    await page.getByRole('button', { name: /STOP/ }).click();
    await expect.poll(posts).toEqual(['/rig/stop']);
    await page.getByLabel('camera tilt: move to, degrees').focus();
    await page.keyboard.press('Escape');
    await expect.poll(posts).toEqual(['/rig/stop', '/rig/stop']);
  });

  it('says so loudly when it did not get through', async () => {
    daemon.refusals.set('POST /rig/stop', { status: 503, body: { code: 'stage-no-reply', title: 'no reply', detail: 'the controller does not answer' } });
    await page.goto(url);
    await page.keyboard.press('Escape');
    await page.getByRole('alert').filter({ hasText: 'use the rig’s own switch. The controller does not answer.' }).waitFor();
  });

  it('is in view on a narrow screen however far one scrolls', async () => {
    daemon.addFit(daemon.addScan(1, 'full'));
    await page.setViewportSize({ width: 390, height: 700 });
    await page.goto(url);
    await page.getByTestId('parameters').waitFor();
    await page.evaluate(() => scrollTo(0, document.body.scrollHeight));
    const box = await page.getByRole('button', { name: /STOP/ }).boundingBox();
    expect(box).not.toBeNull();
    expect(box?.y).toBeGreaterThanOrEqual(0);
    expect((box?.y ?? 1e9) + (box?.height ?? 0)).toBeLessThan(700);
    const overflow = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
    expect(overflow).toBeLessThanOrEqual(0);
  });
});

describe('moving by hand', () => {
  it('refuses an angle beyond the travel before asking', async () => {
    await page.goto(url);
    await page.getByLabel('camera tilt: move to, degrees').fill('75');
    expect(await page.getByText('Between −60° and 60°.').isVisible()).toBe(true);
    expect(await page.locator('[data-axis=theta_c]').getByRole('button', { name: 'Move' }).isDisabled()).toBe(true);
    expect(posts()).toEqual([]);
  });

  it('sends the angle typed with a comma or a true minus', async () => {
    await page.goto(url);
    await page.getByLabel('camera tilt: move to, degrees').fill('−12,5');
    await page.locator('[data-axis=theta_c]').getByRole('button', { name: 'Move' }).click();
    await expect.poll(() => daemon.requests.find((r) => r.path.startsWith('/rig'))).toEqual({ method: 'POST', path: '/rig/axes/theta_c/move', body: { position_deg: -12.5 } });
    await expect.poll(() => text('[data-axis=theta_c] output')).toBe('−12.500°');
  });
});

describe('faults', () => {
  it('shows a refusal as a sentence and lets it be closed', async () => {
    daemon.addScan(1, 'paper');
    daemon.refusals.set('POST /fits', { status: 507, body: { code: 'disk-full', title: 'no room', detail: 'the disk of /data has 3 MB left: remove something or move the store' } });
    await page.goto(url);
    await page.getByRole('button', { name: 'Fit', exact: true }).click();
    const alert = page.getByRole('alert').filter({ hasText: 'The disk of /data has 3 MB left: remove something or move the store.' });
    await alert.waitFor();
    await alert.getByRole('button', { name: 'Close' }).click();
    await alert.waitFor({ state: 'detached' });
  });

  it('asks for an estimate once, not whenever the rig reports', async () => {
    await page.goto(url);
    await page.getByText('53 frames').waitFor();
    for (let i = 0; i < 5; i++) {
      daemon.event('rig', {});
      await page.waitForTimeout(150);
    }
    expect(daemon.requests.filter((r) => r.path === '/scans/estimate')).toHaveLength(1);
  });

  it('says why a plan cannot run before it is started', async () => {
    await page.goto(url);
    await page.getByText('custom', { exact: true }).click();
    await page.getByLabel(/Camera tilts/).fill('0, 75');
    await page.getByText('75° is beyond the limit of 60°.').waitFor();
    expect(await page.getByRole('button', { name: 'Start scan' }).isDisabled()).toBe(true);
  });

  it('gives an axis’s warnings as the daemon words them, once', async () => {
    daemon.axes.theta_c.warnings = ['WR: no reference position; home the axis'];
    await page.goto(url);
    await expect.poll(() => text('[data-axis=theta_c] .warning')).toBe('WR no reference position; home the axis');
  });

  it('names the port that is missing, and is on again by its own button, by homing or by a start', async () => {
    daemon.connected = false;
    daemon.plugged = false;
    await page.goto(url);
    await page.getByText('The serial port /dev/ttyUSB0 does not exist').waitFor();
    expect(await page.getByRole('button', { name: /STOP/ }).isEnabled()).toBe(true);
    // What nobody hears may be moving, and is nowhere to be moved from.
    expect(await page.locator('[data-axis] .chip').allInnerTexts()).toEqual(['not known', 'not known']);
    const tilt = page.locator('[data-axis=theta_c]');
    expect(await tilt.getByLabel('camera tilt: move to, degrees').isDisabled()).toBe(true);
    const again = page.getByRole('button', { name: 'Connect again' });
    await again.click();
    await page.getByText('Still not connected.').waitFor();
    daemon.plugged = true;
    await again.click();
    await page.getByText('at rest').waitFor();
    expect(await again.count()).toBe(0);
    expect(posts()).toEqual(['/rig/stop', '/rig/stop']);
    for (const press of [tilt.getByRole('button', { name: 'Home' }), page.getByRole('button', { name: 'Start scan' })]) {
      daemon.connected = false;
      daemon.event('rig', {});
      await page.getByText('stages not connected').waitFor();
      await press.click();
      daemon.connected = true;
      await page.getByText('stages not connected').waitFor({ state: 'detached' });
    }
    expect(posts().slice(2)).toEqual(['/rig/axes/theta_c/home', '/scans']);
  });

  it('shows an alarm until it is seen', async () => {
    await page.goto(url);
    await page.getByText('at rest').waitFor();
    await expect.poll(async () => {
      daemon.event('alarm', { code: 'stage-stalled', message: 'the tilt axis stalled at 12.3°', scan_id: null });
      return page.getByText('The tilt axis stalled at 12.3°.').count();
    }).toBeGreaterThan(0);
    for (let n = await page.getByRole('button', { name: 'Seen' }).count(); n > 0; n--) await page.getByRole('button', { name: 'Seen' }).first().click();
    expect(await page.getByText('The tilt axis stalled at 12.3°.').count()).toBe(0);
  });

  it('finds the daemon again after it was away, and what happened meanwhile', async () => {
    await page.goto(url);
    await page.getByText('at rest').waitFor();
    const port = Number(new URL(url).port);
    await daemon.stop();
    await page.getByText('The daemon cannot be reached.').waitFor();
    daemon = new MockDaemon({ dist: DIST, frameMs: 5 });
    daemon.addFit(daemon.addScan(2, 'paper'));
    await daemon.start(port);
    await page.getByText('at rest').waitFor();
    await expect.poll(() => text('[data-parameter=theta_r_deg]')).toBe('15.031 ± 0.085°');
  });
});

describe('a scan', () => {
  it('asks for its steps, counts its frames and is fitted', async () => {
    await page.goto(url);
    await page.getByRole('combobox', { name: 'Sample' }).selectOption({ label: 'model 15° (n 1.54)' });
    await page.getByRole('button', { name: 'Start scan' }).click();
    for (const step of ['Cap the lens', 'Place the white reference', 'Place the sample model 15°']) {
      await page.getByRole('heading', { name: step }).waitFor();
      await page.getByRole('button', { name: 'Continue' }).click();
    }
    await page.getByRole('button', { name: 'Fit', exact: true }).click();
    await expect.poll(() => text('[data-parameter=theta_r_deg]')).toBe('15.031 ± 0.085°');
    expect(posts()).toEqual(['/scans', ...Array(3).fill('/scans/1/continue'), '/fits']);
    // Each says which step it is of: the scan may wait for another one by then.
    const said = daemon.requests.filter((r) => r.path === '/scans/1/continue').map((r) => r.body);
    expect(said).toEqual([{ action: 'cap-lens' }, { action: 'place-white-reference' }, { action: 'place-sample' }]);
  });

  it('shows frames of a fast rig together, some times a second, and misses none', async () => {
    await page.goto(url);
    await page.getByText('full', { exact: true }).click();
    await page.getByRole('button', { name: 'Start scan' }).click();
    for (let i = 0; i < 3; i++) await page.getByRole('button', { name: 'Continue' }).click();
    // How often the number of sample frames changes beside their poses, up to the last.
    const { changes, seconds } = await page.evaluate(
      () =>
        new Promise<{ changes: number; seconds: number }>((done) => {
          const numbers = (): string => document.querySelector('.kinds')?.textContent ?? '';
          const [begun, seen] = [performance.now(), new Set([numbers()])];
          const look = new MutationObserver(() => {
            seen.add(numbers());
            if (document.querySelector('section[aria-labelledby=answer-title] .chip')?.textContent !== 'completed') return;
            look.disconnect();
            done({ changes: seen.size - 1, seconds: (performance.now() - begun) / 1000 });
          });
          look.observe(document.body, { subtree: true, childList: true, characterData: true });
        }),
    );
    expect(changes).toBeGreaterThan(1);
    // Four a second, and where the scan's state changes.
    expect(changes).toBeLessThanOrEqual(4 * seconds + 10);
    const { n } = await page.evaluate(async () => ({ n: ((await (await fetch('/api/v1/scans/1/frames?limit=1000')).json()) as { items: unknown[] }).items.length }));
    const shown = (await text('.kinds')).match(/\d+/g)?.reduce((sum, k) => sum + Number(k), 0);
    expect(shown).toBe(n);
  });

  it('pauses, resumes and is aborted only when confirmed', async () => {
    // 336 frames: the scan must not be over before the test is.
    daemon.frameMs = 100;
    await page.goto(url);
    await page.getByText('full', { exact: true }).click();
    await page.getByRole('button', { name: 'Start scan' }).click();
    for (let i = 0; i < 3; i++) await page.getByRole('button', { name: 'Continue' }).click();
    await page.getByRole('button', { name: 'Pause' }).click();
    await page.getByRole('button', { name: 'Resume' }).click();
    await page.getByRole('button', { name: 'Abort …' }).click();
    await page.getByRole('button', { name: 'Keep' }).click();
    await page.getByRole('button', { name: 'Pause' }).click();
    await page.locator('header').getByText('scan paused').waitFor();
    await page.getByRole('button', { name: 'Abort …' }).click();
    await page.getByRole('button', { name: 'Abort for good' }).click();
    await page.getByText('aborted').first().waitFor();
    expect(posts().filter((p) => p.endsWith('/abort'))).toHaveLength(1);
  });
});

describe('the form of a new scan', () => {
  const plan = (): unknown => (daemon.requests.findLast((r) => r.path === '/scans')?.body as { plan?: unknown } | undefined)?.plan;
  const start = () => page.getByRole('button', { name: 'Start scan' });

  it('takes no decimal comma for something else, and says what it read', async () => {
    await page.goto(url);
    await page.getByText('53 frames').waitFor();
    await page.getByLabel('Repeats').fill('1,5');
    await page.getByText('Repeats: a whole number from 1 to 100.').waitFor();
    expect(await start().isDisabled()).toBe(true);
    await page.getByLabel('Repeats').fill('2');
    await page.getByLabel('Exposures, ms').fill('2,5');
    await page.getByText('“2,5” can be read in two ways').waitFor();
    expect(await start().isDisabled()).toBe(true);
    await page.getByLabel('Exposures, ms').fill('2, 5');
    await expect.poll(() => text('[data-testid=readings]')).toBe('2 exposures: 2 ms, 5 ms');
    await start().click();
    await expect.poll(plan).toEqual({ preset: 'paper', repeats: 2, exposures_s: [0.002, 0.005] });
  });

  it('names what it would use again, and takes it anew where that is wished', async () => {
    daemon.calibrations.push({ id: 8, kind: 'flat', scan_id: 1, created_at: new Date(2026, 0, 2, 17, 34).toISOString() }, { id: 7, kind: 'dark', scan_id: 1, created_at: new Date(2026, 0, 2, 17, 31).toISOString() });
    await page.goto(url);
    const card = page.getByTestId('calibrations');
    await card.getByText('Used again: white reference of scan 1 (2026-01-02 17:34), dark frames of scan 1 (2026-01-02 17:31).').waitFor();
    await card.getByLabel('take new dark frames').check();
    await card.getByText('Used again').waitFor({ state: 'detached' });
    await start().click();
    await expect.poll(plan).toEqual({ preset: 'paper', repeats: 1, reuse_calibrations: false });
  });

  it('adds a plastic with its uncertainty and a metal by its name, and says beside a field what is wrong', async () => {
    const sent = (): unknown => daemon.requests.findLast((r) => r.path === '/samples')?.body;
    await page.goto(url);
    const sample = page.getByRole('combobox', { name: 'Sample' });
    await sample.selectOption({ label: 'New sample …' });
    const form = page.getByTestId('sample-form');
    await form.getByLabel('Name', { exact: true }).fill('model 15°');
    await form.getByText('There is a sample of this name already, no. 2.').waitFor();
    await form.getByLabel('Index n', { exact: true }).fill('abc');
    await form.getByText('“abc” is not a number.').waitFor();
    await form.getByRole('button', { name: 'Add sample' }).click();
    expect(posts()).toEqual([]);
    await form.getByLabel('Index n', { exact: true }).fill('1,49');
    await form.getByLabel('Standard uncertainty of n').fill('0,02');
    await form.getByRole('button', { name: 'Add sample' }).click();
    await expect.poll(sent).toEqual({ name: 'model 15°', material: { kind: 'dielectric', eta: 1.49, eta_std: 0.02 } });
    await expect.poll(() => sample.locator('option:checked').innerText()).toBe('model 15° (n 1.49)');
    await sample.selectOption({ label: 'New sample …' });
    await form.getByLabel('Name', { exact: true }).fill('die 4');
    await form.getByLabel('Material').selectOption('metal');
    await form.getByRole('combobox', { name: 'Metal', exact: true }).selectOption('Cu');
    await form.getByRole('button', { name: 'Add sample' }).click();
    await expect.poll(sent).toEqual({ name: 'die 4', metal: { name: 'Cu' } });
    await expect.poll(() => sample.locator('option:checked').innerText()).toBe('die 4 (n 3.12, k 3.33)');
  });
});

describe('an address of something that is not there', () => {
  it('shows nothing else in its place, and the way to what is there', async () => {
    const scan = daemon.addScan(1, 'paper');
    daemon.addFit(scan);
    await page.goto(`${url}/#/scan/999`);
    const card = page.getByTestId('missing');
    await expect.poll(() => card.innerText()).toBe('Scan 999 is not in this store. The newest is scan 1, traced polymer.');
    expect(await page.locator('#answer-title').count()).toBe(0);
    await card.getByRole('link').click();
    await page.locator('#answer-title').waitFor();
    expect(await card.count()).toBe(0);
    await page.goto(`${url}/#/scan/1/fit/999`);
    await expect.poll(() => card.innerText()).toBe('Fit 999 is not one of scan 1. Its newest is fit 1.');
    expect(await page.locator('[data-parameter]').count()).toBe(0);
  });
});

describe('observations', () => {
  const asked = (): string[] => daemon.reads.filter((path) => path.includes('/observations'));

  it('are not asked for before a frame of the sample is in, and again when the scan ends before its time', async () => {
    daemon.frameMs = 40;
    await page.goto(url);
    await page.getByRole('button', { name: 'Start scan' }).click();
    for (let i = 0; i < 2; i++) await page.getByRole('button', { name: 'Continue' }).click();
    await page.getByRole('heading', { name: 'Place the sample' }).waitFor();
    expect(asked()).toEqual([]);
    await page.getByRole('button', { name: 'Continue' }).click();
    await page.locator('.kinds').getByText(/^sample [1-9]/).waitFor();
    await page.getByRole('button', { name: 'Abort …' }).click();
    await page.getByRole('button', { name: 'Abort for good' }).click();
    await page.getByText('aborted').first().waitFor();
    await page.getByTestId('curves').waitFor();
  });

  it('are shown where a fit kept none, and of a sample of several regions those of the chosen one', async () => {
    daemon.regions = ['left', 'right half'];
    daemon.addFit(daemon.addScan(1, 'paper'));
    daemon.refusals.set('GET /fits/1/curve', { status: 200, body: { peak: 0, observations: [], curves: [] } });
    await page.goto(url);
    await expect.poll(() => page.getByTestId('curves').locator('figure').count()).toBe(5);
    await page.getByTestId('fit-form').getByLabel('Region').selectOption('right half');
    await expect.poll(asked).toContainEqual(expect.stringContaining('region=right%20half'));
    expect(await page.getByRole('link', { name: 'Observations as CSV' }).getAttribute('href')).toContain('region=right%20half');
  });
});

describe('a map', () => {
  it('is not begun with a time that is none', async () => {
    daemon.addScan(1, 'paper');
    await page.goto(url);
    const limit = page.getByLabel('Seconds that the map may take');
    const begin = page.getByRole('button', { name: 'Map every pixel' });
    for (const wrong of ['-5', 'abc', '0']) {
      await limit.fill(wrong);
      await page.getByText('At most: a number of seconds above 0').waitFor();
      expect(await begin.isDisabled()).toBe(true);
    }
    await limit.fill('0,5');
    await begin.click();
    await expect.poll(() => daemon.requests.find((r) => r.path === '/maps')?.body).toEqual({ scan_id: 1, max_seconds: 0.5 });
  });
});

describe('a step that waits', () => {
  it.each([1280, 400])('stays in view however far one scrolls, %i pixels wide, and leaves the page room', async (width) => {
    daemon.addFit(daemon.addScan(1, 'full'));
    await page.setViewportSize({ width, height: 700 });
    await page.goto(url);
    await page.getByRole('button', { name: 'Start scan' }).click();
    await page.locator('header').getByText('waits for you: cap the lens').waitFor();
    await page.evaluate(() => scrollTo(0, document.body.scrollHeight));
    const box = await page.getByRole('button', { name: 'Continue' }).boundingBox();
    expect(box?.y ?? -1).toBeGreaterThanOrEqual(0);
    expect((box?.y ?? 1e9) + (box?.height ?? 0)).toBeLessThan(350);
  });
});

describe('a frame', () => {
  it('tells the full 16-bit count of the pixel under the cursor, by pointer and by keys', async () => {
    daemon.addScan(1, 'paper');
    await page.goto(url);
    const canvas = page.getByTestId('frame');
    await canvas.waitFor();
    await expect.poll(() => canvas.evaluate((c) => (c as HTMLCanvasElement).width)).toBe(96);
    await canvas.scrollIntoViewIfNeeded();
    const box = await canvas.boundingBox();
    if (!box) throw new Error('the frame is not shown');
    await canvas.hover({ position: { x: ((5 + 0.5) / 96) * box.width, y: ((3 + 0.5) / 96) * box.height } });
    await expect.poll(() => text('[data-testid=pixel]')).toBe('column 5, row 3: 12 345 DN');
    await page.locator('.stage').focus();
    await page.keyboard.press('ArrowRight');
    await expect.poll(() => text('[data-testid=pixel]')).toMatch(/^column 6, row 3: /);
  });

  it('paints saturated pixels in a colour of their own, and only when asked to', async () => {
    daemon.addScan(1, 'full');
    await page.goto(url);
    await page.getByRole('button', { name: 'θc −15°, φs 180°', exact: false }).click();
    await page.getByRole('button', { name: '0.18 s' }).click();
    const red = (): Promise<number> =>
      page.getByTestId('frame').evaluate((c) => {
        const canvas = c as HTMLCanvasElement;
        const rgba = canvas.getContext('2d')?.getImageData(0, 0, canvas.width, canvas.height).data ?? [];
        let n = 0;
        for (let i = 0; i < rgba.length; i += 4) if (rgba[i] === 255 && rgba[i + 1] === 45 && rgba[i + 2] === 85) n += 1;
        return n;
      });
    await expect.poll(red).toBeGreaterThan(100);
    await page.getByLabel('mark saturated').uncheck();
    await expect.poll(red).toBe(0);
  });
});

describe('the map of poses', () => {
  it('is one stop of the Tab key, is crossed by arrow keys, and says what its colours are', async () => {
    daemon.addScan(1, 'full');
    await page.goto(url);
    const poses = page.getByTestId('poses');
    await poses.waitFor();
    expect(await poses.locator('button[tabindex="0"]').count()).toBe(1);
    expect(await poses.locator('button').count()).toBe(108);
    await poses.locator('button[tabindex="0"]').focus();
    const before = await poses.locator('button[aria-current]').getAttribute('data-at');
    await page.keyboard.press('ArrowDown');
    await page.keyboard.press('ArrowLeft');
    const [row, column] = (before ?? '').split(' ').map(Number);
    expect(await poses.locator('button[aria-current]').getAttribute('data-at')).toBe(`${(row ?? 0) + 1} ${(column ?? 0) - 1}`);
    expect(await poses.locator('button:focus').getAttribute('tabindex')).toBe('0');
    expect(await text('[data-testid=pose-scale]')).toMatch(/^0 [\d ]+ DN\/s$/);
  });
});

describe('a fit', () => {
  it('is asked for with the model of its own scan, not of the one before', async () => {
    daemon.addScan(1, 'paper');
    const other = daemon.addScan(2, 'paper');
    await page.goto(`${url}/#/scan/1`);
    const model = page.getByTestId('fit-form').getByLabel('Model');
    await model.selectOption('traced');
    await page.goto(`${url}/#/scan/${other}`);
    await expect.poll(() => model.inputValue()).toBe('auto');
  });

  it('says which parameter the data cannot tell, and what an uncertainty is made of', async () => {
    const scan = daemon.addScan(1, 'full');
    daemon.addFit(scan, 'paper');
    await page.goto(url);
    const tilt = page.locator('[data-row=tilt_offset_deg]');
    await tilt.waitFor();
    expect(await tilt.innerText()).toContain('not determined by these data');
    expect(await tilt.innerText()).toContain('three azimuths cannot tell it');
    await page.locator('[data-row=theta_r_deg]').getByRole('button').click();
    expect(await text('#budget-theta_r_deg')).toContain('angles 0.021° · 0.99 % of the variance');
  });

  it('is compared with others, and another one is shown by its link', async () => {
    daemon.addFit(daemon.addScan(1, 'full'), 'paper');
    daemon.addFit(daemon.addScan(2, 'paper'));
    await page.goto(url);
    await expect.poll(() => text('[data-parameter=theta_r_deg]')).toBe('15.031 ± 0.085°');
    await page.getByTestId('fits').getByRole('link', { name: '1', exact: true }).click();
    await expect.poll(() => text('[data-parameter=theta_r_deg]')).toBe('10.61 ± 0.42°');
    expect(await page.getByTestId('curves').locator('figure').count()).toBe(9);
    expect(new URL(page.url()).hash).toBe('#/scan/1/fit/1');
  });
});

describe('a store of many fits', () => {
  it('is read page by page, and shows the fit of the address however old it is', async () => {
    daemon.addFit(daemon.addScan(2, 'paper'));
    const scan = daemon.addScan(1, 'paper');
    for (let i = 0; i < 230; i++) daemon.addFit(scan);
    await page.goto(`${url}/#/scan/1/fit/1`);
    await expect.poll(() => text('[data-parameter=theta_r_deg]')).toBe('15.031 ± 0.085°');
    expect(await page.getByTestId('missing').count()).toBe(0);
    const rows = page.getByTestId('fits').locator('tbody tr');
    expect(await rows.count()).toBe(50);
    expect(await page.getByTestId('fits-count').innerText()).toBe('101 newest fits');
    const older = page.getByRole('button', { name: 'Older fits' });
    for (const n of [100, 150, 200, 231]) {
      await older.click();
      await expect.poll(() => rows.count()).toBe(n);
    }
    expect(await older.count()).toBe(0);
    expect(await page.getByTestId('fits-count').innerText()).toBe('231 fits');
    // Three pages of all, and one of the scan that is looked at.
    expect(daemon.reads.filter((path) => path.startsWith('/fits?'))).toHaveLength(4);
  });
});

describe('the fit of a metal', () => {
  it('has no diffuse reflectance, and nothing is wrong with that', async () => {
    daemon.addFit(daemon.addScan(1, 'paper'));
    const parameters = daemon.fits[0]?.['parameters'] as Record<string, unknown>;
    parameters['rho_d'] = { value: null, std: null, expanded: null, coverage_factor: null, identifiable: false, budget: null, note: 'a metal sends no light back from below its surface: there is no ρd to measure' };
    await page.goto(url);
    const place = page.locator('[data-parameter=rho_d] span');
    await place.waitFor();
    expect(await place.innerText()).toBe('none: a metal');
    expect(await place.getAttribute('class')).not.toContain('bad');
  });
});

describe('the uncertainty along a scan', () => {
  const row = (id: number) => ({ id, elapsed_s: 9 * id, n_observations: id, n_frames_used: id, variant: 'sawtooth', status: 'converged', parameters: { theta_r_deg: { value: 10, std: 0.3 / id } } });

  it.each([[1, 0], [2, 1]])('of %i fits and the last one is drawn as %i plots, in words always', async (fits, plots) => {
    for (let id = 1; id <= fits; id++) daemon.certainties.push(row(id));
    daemon.addFit(daemon.addScan(1, 'paper'));
    await page.goto(url);
    const card = page.getByTestId('certainty');
    await card.waitFor();
    expect(await card.locator('[data-line=theta_r_deg]').innerText()).toMatch(/10\.031°, u = 0\.043°/);
    await expect.poll(() => card.locator('canvas').count()).toBe(plots);
    expect(await card.innerText()).toMatch(/After \d+(\.\d+)? s: 15 poses/);
  });
});

describe('a long name without a blank', () => {
  it.each([1280, 400])('makes nothing wider than a screen of %i pixels', async (width) => {
    const surface = { theta_r_deg: 12, alpha_u: 0.1, alpha_v: 0.1, rho_d: 0.2 };
    const scan = daemon.addScan(daemon.addSample(`part_${'0123456789'.repeat(12)}`, surface), 'full');
    daemon.addFit(scan);
    daemon.addFit(scan, 'paper');
    await page.setViewportSize({ width, height: 900 });
    await page.goto(url);
    await page.getByTestId('fits').waitFor();
    expect(await page.evaluate(() => document.documentElement.scrollWidth - innerWidth)).toBeLessThanOrEqual(0);
    // How a fit ended is in view: the last of its columns.
    const [chip, list] = await page.getByTestId('fits').evaluate((table) => [table.querySelector('td .chip')?.getBoundingClientRect().right, table.parentElement?.getBoundingClientRect().right]);
    expect(chip ?? 1e9).toBeLessThanOrEqual(list ?? 0);
    const hidden = await page.getByTestId('fits').evaluate((table) => (table.parentElement?.scrollWidth ?? 1e9) - (table.parentElement?.clientWidth ?? 0));
    if (width === 1280) expect(hidden).toBeLessThanOrEqual(0);
  });
});

describe('error against run time', () => {
  const point = (method: string, seconds: number, error: number, scene = 'flat 1.5/2.4 at 60°') => ({
    scene, method, seconds, error, quantity: 'relative error of the reflected energy', reference: 'exact (flat layers)',
  });

  it('is shown where it was measured: a line per method, its slope, the reference and what plans leave out', async () => {
    daemon.accuracy = {
      machine: 'ridged, two threads', written_at: '2026-01-02T03:04:05Z',
      points: [point('split', 0.01, 1e-2), point('split', 0.1, 3.16e-3), point('split', 1, 1e-3), point('analog', 0.1, 2e-2), point('scalar', 0.01, 1.5e-2), point('scalar', 0.1, 1.6e-2), point('scalar', 1, 1.7e-2), point('quadrature', 0.2, 1e-4, 'series')],
      forecasts: [{ scene: 'flat', forecast_s: 1, taken_s: 1.5 }, { scene: 'rough', forecast_s: 1, taken_s: 3 }],
      proofs: [{ scene: 'flat', off: 0.002, allowed: 0.011, holds: true, full_s: 0.3, planned_s: 0.1, parts: [{ what: 'polarisation of light', speed_up: 2.9 }] }],
    };
    await page.goto(url);
    const view = page.getByTestId('accuracy');
    await view.waitFor();
    await expect.poll(() => view.locator('g[data-method]').count()).toBe(3);
    expect(await view.locator('g[data-method=split] circle').count()).toBe(3);
    expect(await view.locator('text[data-axis=y]').textContent()).toBe('relative error');
    const words = await view.innerText();
    for (const part of ['slope −0.50', 'levels off', 'exact (flat layers)', '1 of 1 within', 'factor of 2: 1 of 2', 'ridged, two threads']) expect(words).toContain(part);
    await view.locator('summary').click();
    expect(await view.getByTestId('proofs').innerText()).toContain('polarisation of light');
    await view.getByRole('combobox', { name: 'Scene' }).selectOption('series');
    await expect.poll(() => view.locator('g[data-method]').count()).toBe(1);
  });

  it('is not shown where nothing was measured', async () => {
    await page.goto(url);
    await page.getByRole('button', { name: 'Start scan' }).waitFor();
    expect(await page.getByTestId('accuracy').count()).toBe(0);
  });
});

describe('the options of a fit', () => {
  const sent = (): unknown => daemon.requests.findLast((r) => r.path === '/fits' && r.method === 'POST')?.body;

  it('are sent as they are chosen, and the result says what was asked', async () => {
    daemon.addScan(1, 'paper');
    await page.goto(url);
    const form = page.getByTestId('fit-form');
    const fit = form.getByRole('button', { name: 'Fit', exact: true });
    await form.getByRole('button', { name: 'Options' }).click();
    await form.getByLabel('Profile intervals').check();
    await form.getByLabel('Outliers').selectOption('huber');
    const known = form.getByRole('button', { name: 'Something is known beforehand' });
    await known.click();
    await known.click();
    await form.getByLabel('Known beforehand: parameter').first().selectOption('rho_d');
    await form.getByLabel('Known beforehand: parameter').nth(1).selectOption('theta_r_deg');
    await form.getByLabel('Known beforehand: value').first().fill('0,3');
    await form.getByLabel('Known beforehand: value').nth(1).fill('ten');
    await form.getByRole('alert').filter({ hasText: 'The ridge angle: give its value as a number.' }).waitFor();
    expect(await fit.isDisabled()).toBe(true);
    await form.getByLabel('Known beforehand: value').nth(1).fill('10');
    await form.getByLabel('Known beforehand: standard uncertainty').nth(1).fill('0.5');
    await fit.click();
    await expect.poll(sent).toEqual({ scan_id: 1, variant: 'auto', loss: 'huber', profile: true, fix: { rho_d: 0.3 }, priors: { theta_r_deg: { value: 10, std: 0.5 } } });
    await expect.poll(() => text('[data-testid=asked]')).toBe('model best, outliers count less (Huber), ρd held at 0.3, θr known as 10 ± 0.5°, profile intervals');
  });

  it('are refused beside themselves', async () => {
    daemon.addScan(1, 'paper');
    daemon.refusals.set('POST /fits', { status: 422, body: { code: 'invalid-value', title: 'a value makes no sense', detail: 'fix.rho_d: lies between 0 and 1' } });
    await page.goto(url);
    const form = page.getByTestId('fit-form');
    await form.getByRole('button', { name: 'Options' }).click();
    await form.getByRole('button', { name: 'Something is known beforehand' }).click();
    await form.getByLabel('Known beforehand: parameter').selectOption('rho_d');
    await form.getByLabel('Known beforehand: value').fill('3');
    await form.getByRole('button', { name: 'Fit', exact: true }).click();
    await form.getByRole('alert').filter({ hasText: 'The diffuse reflectance: lies between 0 and 1.' }).waitFor();
  });
});

describe('a series recorded elsewhere', () => {
  it('is imported from its folder and shown', async () => {
    await page.goto(url);
    await page.getByText('Bring in a recorded series').click();
    await page.getByLabel('Its folder on the daemon’s machine').fill('/data/seven');
    await page.getByRole('button', { name: 'Import' }).click();
    await page.getByText('Scan 1 with 48 frames; left out: frames/7.png.').waitFor();
    expect(daemon.requests.find((r) => r.path === '/imports')?.body).toEqual({ folder: '/data/seven', skip_unreadable: false });
    await page.locator('#answer-title').waitFor();
  });

  it('says beside the folder what is wrong with it, and what to tick', async () => {
    daemon.refusals.set('POST /imports', { status: 422, body: { code: 'unreadable', title: 'unreadable', detail: 'frames/7.png is torn; nothing was imported: restore the file, or pass --skip-unreadable to leave it out' } });
    await page.goto(url);
    await page.getByText('Bring in a recorded series').click();
    await page.getByLabel('Its folder on the daemon’s machine').fill('/data/seven');
    await page.getByRole('button', { name: 'Import' }).click();
    await page.getByRole('alert').filter({ hasText: 'or tick “leave out frames that cannot be read”.' }).waitFor();
  });
});

describe('the contents of the page', () => {
  it('name the cards that are there and go to them, without touching the address of the scan', async () => {
    daemon.addFit(daemon.addScan(1, 'paper'));
    await page.goto(`${url}/#/scan/1/fit/1`);
    const contents = page.getByTestId('contents');
    await contents.getByRole('link', { name: 'Parameters' }).click();
    await expect.poll(() => page.locator('section[aria-labelledby=parameters-title]').evaluate((e) => Math.round(e.getBoundingClientRect().top) < innerHeight)).toBe(true);
    await expect.poll(() => contents.locator('a[aria-current]').count()).toBe(1);
    expect(new URL(page.url()).hash).toBe('#/scan/1/fit/1');
    expect(await contents.getByRole('link', { name: 'Uncertainty' }).count()).toBe(0);
  });
});

describe('a fit on the sample’s own shape', () => {
  const heights = Buffer.from('0,1,2\n0,1,2\n');
  const map = { name: 'map.csv', mimeType: 'text/csv', buffer: heights };
  const sent = (): unknown => daemon.requests.findLast((r) => r.path === '/fits' && r.method === 'POST')?.body;

  beforeEach(async () => {
    daemon.addScan(1, 'paper');
    await page.goto(url);
    await page.getByTestId('fit-form').getByLabel('Model').selectOption('traced');
  });

  it('sends the file with its units, and the result says what it was traced on', async () => {
    const form = page.getByTestId('fit-form');
    await form.getByLabel('File of heights').setInputFiles(map);
    await form.getByLabel('Samples apart, µm').fill('0,5');
    await form.getByLabel('µm per unit of height').fill('0,001');
    await form.getByRole('button', { name: 'Fit', exact: true }).click();
    await expect.poll(sent).toEqual({ scan_id: 1, variant: 'traced', shape: { name: 'map.csv', content: heights.toString('base64'), pitch_um: 0.5, height_unit_um: 0.001 } });
    await expect.poll(() => text('[data-testid=traced-on]')).toBe('a height map of 6 ridges, 102 µm apart, θr 9.998° by its heights');
  });

  it('says beside the file what the daemon has against it, and fits without it', async () => {
    daemon.refusals.set('POST /fits', { status: 422, body: { code: 'invalid-value', title: 'a value makes no sense', detail: 'shape: map.csv: the file does not say how far its samples are apart: add --pitch-um (pitch_um)' } });
    const form = page.getByTestId('fit-form');
    await form.getByLabel('File of heights').setInputFiles(map);
    await form.getByRole('button', { name: 'Fit', exact: true }).click();
    await form.getByRole('alert').filter({ hasText: 'map.csv: the file does not say how far its samples are apart' }).waitFor();
    daemon.refusals.clear();
    await form.getByRole('button', { name: 'Without' }).click();
    expect(await form.getByRole('alert').count()).toBe(0);
    await form.getByRole('button', { name: 'Fit', exact: true }).click();
    await expect.poll(sent).toEqual({ scan_id: 1, variant: 'traced' });
    await expect.poll(() => text('[data-testid=traced-on]')).toBe('an ideal sawtooth');
  });

  it('does not send what is too large, of another kind or without sense, nor a shape with another model', async () => {
    const form = page.getByTestId('fit-form');
    const fit = form.getByRole('button', { name: 'Fit', exact: true });
    const file = form.getByLabel('File of heights');
    await file.setInputFiles({ ...map, name: 'map.tif', buffer: Buffer.alloc(7_000_000) });
    await form.getByRole('alert').filter({ hasText: 'map.tif has 7.0 MB, and a request takes 6.2 MB' }).waitFor();
    expect(await fit.isDisabled()).toBe(true);
    await file.setInputFiles({ ...map, name: 'map.docx' });
    await form.getByRole('alert').filter({ hasText: 'heights are read from .csv' }).waitFor();
    await file.setInputFiles(map);
    await form.getByLabel('Samples apart, µm').fill('0');
    await form.getByText('a length above 0').waitFor();
    expect(await fit.isDisabled()).toBe(true);
    expect(posts()).toEqual([]);
    await form.getByLabel('Model').selectOption('auto');
    expect(await file.count()).toBe(0);
    await fit.click();
    await expect.poll(sent).toEqual({ scan_id: 1, variant: 'auto' });
  });

  it('does not carry the shape of one sample over to another', async () => {
    const other = daemon.addScan(2, 'paper');
    await page.goto(`${url}/#/scan/1`);
    await page.reload();
    const form = page.getByTestId('fit-form');
    await form.getByLabel('Model').selectOption('traced');
    await form.getByLabel('File of heights').setInputFiles(map);
    await form.getByLabel('Samples apart, µm').waitFor();
    await page.goto(`${url}/#/scan/${other}`);
    await form.getByLabel('Samples apart, µm').waitFor({ state: 'detached' });
    await form.getByLabel('Model').selectOption('traced');
    expect(await form.getByLabel('File of heights').inputValue()).toBe('');
  });
});

describe('a fit that runs', () => {
  it('tells its stage and the time left, and can be cancelled', async () => {
    daemon.addScan(1, 'paper');
    daemon.fitMs = null;
    await page.goto(url);
    await page.getByRole('button', { name: 'Fit', exact: true }).click();
    await page.getByText('Fit 1: tracing, 42 s left').waitFor();
    await page.getByText('Forecast: about 50 s for 108 poses').waitFor();
    await page.getByRole('button', { name: 'Cancel' }).click();
    await page.getByText('Fit 1 was cancelled: it has no result.').waitFor();
    expect(daemon.requests.map((r) => r.path)).toContain('/fits/1/cancel');
    expect(await page.getByTestId('fit-form').getByRole('button', { name: 'Fit again' }).isEnabled()).toBe(true);
  });
});

describe('the virtual ellipsometer', () => {
  it('does not send files that a request cannot carry', async () => {
    await page.goto(url);
    const form = page.getByTestId('trace-form');
    await form.getByLabel('Files of heights').setInputFiles({ name: 'hills.tif', mimeType: 'image/tiff', buffer: Buffer.alloc(7_000_000) });
    await form.getByRole('button', { name: 'Trace' }).click();
    await form.getByRole('alert').filter({ hasText: 'hills.tif has 7.0 MB' }).waitFor();
    expect(posts()).toEqual([]);
  });

  it('says under each field why nothing can be traced', async () => {
    await page.goto(url);
    const form = page.getByTestId('trace-form');
    await form.getByLabel('Photons').fill('1,5e5');
    await form.getByText('A whole number above 0, such as 200000 or 2e5.').waitFor();
    await form.getByLabel('Seconds at most').fill('0');
    await form.getByText('A number of seconds above 0').waitFor();
    await form.getByLabel('Surfaces, drawn anew').fill('5000');
    await form.getByText('A whole number from 2 to 1000').waitFor();
    expect(await form.getByRole('button', { name: 'Trace' }).isDisabled()).toBe(true);
  });

  it('says what is wrong with a scene beside it and selects its line', async () => {
    daemon.refusals.set('POST /traces', { status: 422, body: { code: 'invalid-value', title: 'a value makes no sense', detail: 'scene: the scene cannot be read: TOML parse error at line 2, column 9' } });
    await page.goto(url);
    const form = page.getByTestId('trace-form');
    await form.getByLabel('Scene, TOML').fill('[light]\ntheta = x\n');
    await form.getByRole('button', { name: 'Trace' }).click();
    await form.getByRole('alert').filter({ hasText: 'TOML parse error at line 2' }).waitFor();
    const selected = await form.getByLabel('Scene, TOML').evaluate((e: HTMLTextAreaElement) => e.value.slice(e.selectionStart, e.selectionEnd));
    expect(selected).toBe('theta = x');
  });

  it('sends the files that a scene names, and takes a line of theirs for none of its own', async () => {
    daemon.refusals.set('POST /traces', { status: 422, body: { code: 'invalid-value', title: 'a value makes no sense', detail: 'scene: interface 1: hills.csv: line 2 has 1 heights, the lines before it 2' } });
    await page.goto(url);
    const form = page.getByTestId('trace-form');
    await form.getByLabel('Scene, TOML').fill('[[interface]]\nshape = "file"\npath = "hills.csv"\n');
    await form.getByLabel('Files of heights').setInputFiles({ name: 'hills.csv', mimeType: 'text/csv', buffer: Buffer.from('0,1\n2\n') });
    await form.getByRole('button', { name: 'Trace' }).click();
    await form.getByRole('alert').filter({ hasText: 'hills.csv: line 2 has 1 heights' }).waitFor();
    const selected = await form.getByLabel('Scene, TOML').evaluate((e: HTMLTextAreaElement) => e.value.slice(e.selectionStart, e.selectionEnd));
    expect(selected).toBe('');
    expect(daemon.requests.find((r) => r.path === '/traces')?.body).toMatchObject({ files: { 'hills.csv': Buffer.from('0,1\n2\n').toString('base64') } });
  });

  it('starts the example within its limits, tells the time left, and can be cancelled', async () => {
    await page.goto(url);
    const form = page.getByTestId('trace-form');
    expect(await form.getByLabel('Scene, TOML').inputValue()).toContain('[[interface]]');
    await form.getByLabel('Photons').fill('2e5');
    await form.getByLabel('Until the error').fill('1,5');
    await form.getByRole('button', { name: 'Trace' }).click();
    const card = page.getByTestId('traces');
    await card.getByText('tracing photons, 42 s left').waitFor();
    expect(daemon.requests.find((r) => r.path === '/traces')?.body).toMatchObject({ photons: 200_000, max_seconds: 60, target_error: 0.015, compare: true });
    await card.getByRole('button', { name: 'Cancel' }).click();
    await card.getByText('was cancelled').waitFor();
  });

  it('shows where the light went, every component by its number, the plane and what was left out', async () => {
    await page.goto(url);
    const card = page.getByTestId('traces');
    await card.getByRole('button', { name: 'Trace', exact: true }).click();
    await card.getByRole('progressbar').waitFor();
    daemon.finishTrace();
    await card.getByTestId('plane-curves').waitFor();
    const words = (await card.innerText()).replace(/\s+/g, ' ');
    for (const part of ['0.70000 ± 0.00040', 'R2', '500 000', 'The target error 0.01 was not reached', 'interference and diffraction', '15 % (15 %)']) expect(words).toContain(part);
    expect(await card.locator('[data-component]').count()).toBe(6);
    const disc = card.getByTestId('hemisphere');
    const reading = card.getByTestId('reading');
    const point = async (share: number): Promise<void> => {
      await disc.scrollIntoViewIfNeeded();
      const box = await disc.boundingBox();
      await disc.hover({ position: { x: share * (box?.width ?? 0), y: 0.5 * (box?.height ?? 0) + 2 } });
    };
    await point(0.75);
    expect(await reading.innerText()).toMatch(/^θ 45\.0°, φ 345\.0° 0\.2000 ± 0\.0010.sr⁻¹$/);
    await card.locator('[data-component=s1]').click();
    await point(0.75);
    expect(await reading.innerText()).toContain('−0.1000 ± 0.0010');
    await disc.press('ArrowDown');
    expect(await reading.innerText()).toContain('θ 55.0°');
    await card.locator('[data-component=dolp]').click();
    await point(0.99);
    expect(await reading.innerText()).toContain('no light');
    // Light that is linear along s: m00 + m01.
    await card.getByLabel('Lamp’s light').selectOption('1');
    await card.locator('[data-component=s0]').click();
    await point(0.75);
    expect(await reading.innerText()).toContain('0.1000 ± 0.0014');
    await card.getByRole('button', { name: 'Mueller' }).click();
    expect(await card.locator('[data-component]').count()).toBe(16);
    await card.getByRole('button', { name: 'Against scalar' }).click();
    await card.locator('[data-component=adm]').click();
    await point(0.75);
    expect(await reading.innerText()).toContain('15.00 ± 0.40');
    expect(await card.getByRole('button', { name: 'Transmitted' }).isDisabled()).toBe(true);
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

describe('names for everybody', () => {
  it('every control has a name, and no element repeats an id', async () => {
    daemon.addFit(daemon.addScan(1, 'full'));
    await page.goto(url);
    await page.getByTestId('parameters').waitFor();
    const bad = await page.evaluate(() => {
      const named = (e: Element): boolean =>
        (e.getAttribute('aria-label') ?? e.textContent ?? '').trim() !== '' ||
        [...((e as HTMLInputElement).labels ?? [])].some((l) => (l.textContent ?? '').trim() !== '');
      const nameless = [...document.querySelectorAll('button, input, select, a')].filter((e) => !named(e)).map((e) => e.outerHTML);
      const ids = [...document.querySelectorAll('[id]')].map((e) => e.id);
      return [...nameless, ...ids.filter((id, i) => ids.indexOf(id) !== i)];
    });
    expect(bad).toEqual([]);
  });
});
