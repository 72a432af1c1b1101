// The page with a mock daemon: a map is read pixel by pixel, by region, by colours and against limits.

import { readFile } from 'node:fs/promises';

import { beforeEach, describe, expect, it } from 'vitest';

import { axeViolations, daemon, page, text, url } from './stage';
import { MAP_HEIGHT, MAP_WIDTH } from '../mock/maps';

const stage = () => page.getByRole('img', { name: /arrow keys move a cross/ });
const readout = (): Promise<string> => text('[data-testid=map-pixel]');

beforeEach(async () => {
  const scan = daemon.addScan(1, 'paper');
  daemon.addFit(scan);
  daemon.mapped.push(scan);
  daemon.specifications.add({ name: 'drawing 4711', limits: { theta_r_deg: { lower: 9.75, upper: 10 } }, decision: { max_false_accept_risk: 0.05, max_false_reject_risk: 0.05 } });
  await page.goto(`${url}/#/result/${scan}/map`);
  await page.getByTestId('map-picture').waitFor();
});

/** A place in the picture: the middle of a pixel. */
async function at(x: number, y: number): Promise<{ x: number; y: number }> {
  await stage().scrollIntoViewIfNeeded();
  const box = await stage().boundingBox();
  if (!box) throw new Error('the picture is not visible');
  return { x: box.x + ((x + 0.5) / MAP_WIDTH) * box.width, y: box.y + ((y + 0.5) / MAP_HEIGHT) * box.height };
}
/** Red, green, blue and opacity of a pixel of the picture. */
const colour = (x: number, y: number): Promise<number[]> =>
  page.getByTestId('map-picture').evaluate((canvas: HTMLCanvasElement, [px, py]) => [...(canvas.getContext('2d')?.getImageData(px ?? 0, py ?? 0, 1, 1).data ?? [])], [x, y]);

describe('a map', () => {
  it('shows value and expanded uncertainty of the pixel under the pointer, and the reason where there is no value', async () => {
    const place = await at(20, 5);
    await page.mouse.move(place.x, place.y);
    // u = √(0.03² + 0.04²) = 0.05°.
    await expect.poll(readout).toBe('column 20, row 5: 10.00 ± 0.10° (k = 2; noise u 0.030°, common u 0.040°)');
    const empty = await at(0, 0);
    await page.mouse.move(empty.x, empty.y);
    await expect.poll(readout).toBe('column 0, row 0: no value (too few observations)');
    const defect = await at(30, 20);
    await page.mouse.click(defect.x, defect.y);
    await page.mouse.move(place.x, place.y);
    // A click keeps the pixel.
    expect(await readout()).toBe('column 30, row 20: 14.00 ± 0.10° (k = 2; noise u 0.030°, common u 0.040°; defect)');
  });

  it('names the azimuth of the lean before its share', async () => {
    await page.getByRole('listitem').filter({ hasText: /^azimuth \d+(\.\d)?°: 100\s%\sof the pixels$/ }).waitFor();
  });

  it('has a histogram with its unit at each mark', async () => {
    const marks = page.locator('.range .axis span');
    await expect.poll(() => marks.count()).toBe(3);
    expect((await marks.allInnerTexts()).every((mark) => mark.endsWith('°'))).toBe(true);
  });

  it('is read by keys only, region included', async () => {
    await stage().focus();
    await page.keyboard.press('ArrowRight');
    expect(await readout()).toContain('column 20, row 15: 10.00 ± 0.10°');
    await page.keyboard.press('Shift+ArrowLeft');
    await page.keyboard.press('ArrowUp');
    expect(await readout()).toContain('column 10, row 14: 9.90 ± 0.10°');
    await page.keyboard.press('Enter');
    await page.keyboard.press('Shift+ArrowRight');
    await page.keyboard.press('ArrowDown');
    await page.keyboard.press('Enter');
    await page.getByRole('heading', { name: 'Region' }).waitFor();
    // Columns 10 to 20 in two rows: 9.90° to 10.00°.
    await expect.poll(() => text('[data-testid=map-region]')).toContain('Mean 9.950° s of a pixel 0.032° n 22 pixels');
    expect(await page.getByLabel('Region: last column').inputValue()).toBe('20');
  });

  it('has statistics of a region drawn by the pointer, or given by numbers', async () => {
    expect(await text('[data-testid=map-region]')).toContain('n 1 196 pixels');
    const [from, to] = [await at(4, 4), await at(8, 6)];
    await page.mouse.move(from.x, from.y);
    await page.mouse.down();
    await page.mouse.move(to.x, to.y, { steps: 4 });
    await page.mouse.up();
    await expect.poll(() => text('[data-testid=map-region]')).toBe('Mean 9.8600° s of a pixel 0.015° n 15 pixels 5 % 9.8400° 50 % 9.8600° 95 % 9.8800°');
    await page.getByText('the region, to its own height').waitFor();
    await page.getByLabel('Region: first column').fill('8');
    await page.getByLabel('Region: first column').press('Tab');
    await expect.poll(() => text('[data-testid=map-region]')).toContain('n 3 pixels');
    await page.getByRole('button', { name: 'Whole map' }).click();
    await expect.poll(() => text('[data-testid=map-region]')).toContain('n 1 196 pixels');
    expect(await page.getByTestId('map-region-box').count()).toBe(0);
  });

  it('has colours from the 1st to the 99th percentile, a chosen range, or the whole', async () => {
    expect(await text('[data-testid=map-bar]')).toBe('9.800° 10.190°');
    const before = await colour(10, 10);
    await page.getByRole('button', { name: 'Whole range' }).click();
    await expect.poll(() => text('[data-testid=map-bar]')).toBe('9.80° 14.00°');
    expect(await colour(10, 10)).not.toEqual(before);
    await page.getByRole('button', { name: '1 % to 99 %' }).click();
    await expect.poll(() => colour(10, 10)).toEqual(before);
    await page.getByLabel('Colours of ridge angle from').fill('10,3');
    await page.getByLabel('Colours of ridge angle from').press('Enter');
    await page.getByText('The first number must be below the second.').waitFor();
    await page.getByLabel('Colours of ridge angle from').fill('9,9');
    await page.getByLabel('Colours of ridge angle from').press('Enter');
    await expect.poll(() => text('[data-testid=map-bar]')).toContain('9.900°');
    const handle = page.getByRole('slider', { name: 'Lowest colour, °' });
    for (const slider of await page.getByRole('slider').all()) expect((await slider.boundingBox())?.height).toBeGreaterThanOrEqual(24);
    await handle.focus();
    await page.keyboard.press('ArrowRight');
    await expect.poll(async () => Number.parseFloat(await text('[data-testid=map-bar]'))).toBeGreaterThan(9.9);
    await page.getByLabel('show u (k = 1)').check();
    await expect.poll(() => text('[data-testid=map-bar]')).toContain('0.03');
  });

  it('shows which pixels are within the limits of a specification, of the map or of a region', async () => {
    await page.getByRole('combobox', { name: 'Limits' }).selectOption('drawing 4711');
    expect(await page.getByLabel('Upper limit, °').inputValue()).toBe('10');
    // u = 0.05°, risk 5 %: fails from 10.0822°, passes below 9.9178° and from 9.8322° on.
    const shares = '[data-testid=map-shares]';
    await expect.poll(() => text(shares)).toMatch(/^pass [\d.]+ % fail [\d.]+ % cannot tell [\d.]+ % of 1 196 pixels$/);
    expect(await colour(6, 10)).toEqual([0, 153, 136, 255]);
    expect(await colour(20, 10)).toEqual([238, 153, 51, 255]);
    expect(await colour(35, 10)).toEqual([204, 51, 17, 255]);
    expect((await colour(0, 0))[3]).toBe(0);
    // Limits belong to one quantity.
    const quantity = page.getByLabel('Quantity of the picture');
    await quantity.selectOption({ label: 'azimuth of the lean' });
    await expect.poll(() => text('[data-testid=map-bar]')).toContain('180');
    expect(await colour(35, 10)).not.toEqual([204, 51, 17, 255]);
    await quantity.selectOption({ label: 'ridge angle' });
    await page.getByRole('combobox', { name: 'Limits' }).selectOption('drawing 4711');
    for (const [name, value] of [['first column', '4'], ['last column', '11']] as const) {
      await page.getByLabel(`Region: ${name}`).fill(value);
      await page.getByLabel(`Region: ${name}`).press('Tab');
    }
    await expect.poll(() => text(shares)).toBe('pass 100.0 % fail 0.0 % cannot tell 0.0 % of 240 pixels of the region');
    await page.getByLabel('Upper limit, °').fill('9');
    await page.getByText('Limits: the lower limit is above the upper one.').waitFor();
    expect(await page.getByTestId('map-shares').count()).toBe(0);
    await quantity.selectOption({ label: 'roughness along the ridges' });
    await page.getByTestId('map-picture').waitFor();
    expect(await page.getByLabel('Upper limit', { exact: true }).inputValue()).toBe('');
  });

  it('is saved as shown, and as numbers', async () => {
    const [download] = await Promise.all([page.waitForEvent('download'), page.getByRole('button', { name: 'picture (PNG)' }).click()]);
    expect(download.suggestedFilename()).toBe('map-1-theta_r_deg.png');
    const png = await readFile(await download.path());
    expect([...png.subarray(1, 4)].map((c) => String.fromCharCode(c)).join('')).toBe('PNG');
    expect(png.readUInt32BE(16)).toBe(16 * MAP_WIDTH + 48);
    expect(await page.getByRole('link', { name: 'numbers (TIFF)' }).getAttribute('href')).toBe('/api/v1/maps/1/files/theta_r_deg.tif');
    await page.getByLabel('Quantity of the picture').selectOption('flags');
    await page.getByText('too few observations').waitFor();
    await stage().focus();
    await page.keyboard.press('ArrowDown');
    await expect.poll(readout).toBe('column 20, row 15: good');
  });

  it('says why it cannot be shown', async () => {
    daemon.refusals.set('GET /maps/1/files/alpha_u.tif', { status: 404, body: { status: 404, code: 'not-found', title: 'not found', detail: 'the file alpha_u.tif of map 1 is missing' } });
    await page.getByLabel('Quantity of the picture').selectOption({ label: 'roughness along the ridges' });
    await page.getByRole('alert').getByText('The map cannot be shown.').waitFor();
  });

  it('has no white block in the dark theme, no violation of axe-core, and fits 320 pixels', async () => {
    await page.getByRole('combobox', { name: 'Limits' }).selectOption('drawing 4711');
    for (const theme of ['light', 'dark'] as const) {
      await page.evaluate((name) => (document.documentElement.dataset['theme'] = name), theme);
      expect(await axeViolations()).toEqual([]);
    }
    expect(await stage().evaluate((element) => getComputedStyle(element).backgroundColor)).toBe('rgb(17, 22, 28)');
    await page.setViewportSize({ width: 320, height: 640 });
    expect(await page.evaluate(() => document.documentElement.scrollWidth - innerWidth)).toBeLessThanOrEqual(0);
  });
});
