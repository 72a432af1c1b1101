// The page with a mock daemon: frames, poses, curves and maps of a scan.

import { describe, expect, it } from 'vitest';

import { chooseSample, daemon, page, text, url } from './stage';

describe('observations', () => {
  const asked = (): string[] => daemon.reads.filter((path) => path.includes('/observations'));

  it('are not read before the first frame of the sample, and read again when the scan ends early', async () => {
    daemon.frameMs = 120;
    await page.goto(url);
    await chooseSample();
    await page.getByRole('button', { name: 'Start scan' }).click();
    for (let i = 0; i < 2; i++) await page.getByRole('button', { name: 'Continue' }).click();
    await page.getByRole('heading', { name: 'Place the part' }).waitFor();
    expect(asked()).toEqual([]);
    await page.getByRole('button', { name: 'Continue' }).click();
    await page.getByText(/^sample, [1-9]\d* of/).waitFor();
    await page.getByRole('button', { name: 'Abort …' }).click();
    await page.getByRole('button', { name: 'Abort for good' }).click();
    await page.getByText('aborted').first().waitFor();
    await page.getByTestId('curves').waitFor();
  });

  it('are shown if a fit kept none, for the chosen region of the part', async () => {
    daemon.regions = ['left', 'right half'];
    daemon.addFit(daemon.addScan(1, 'paper'));
    daemon.refusals.set('GET /fits/1/curve', { status: 200, body: { peak: 0, observations: [], curves: [] } });
    await page.goto(`${url}/#/result`);
    await expect.poll(() => page.getByTestId('curves').locator('figure').count()).toBe(5);
    await page.getByTestId('fit-form').getByLabel('Region').selectOption('right half');
    await expect.poll(asked).toContainEqual(expect.stringContaining('region=right%20half'));
    expect(await page.getByRole('link', { name: 'Observations as CSV' }).getAttribute('href')).toContain('region=right%20half');
  });
});

describe('the frames of a scan', () => {
  it('are being read until they are: none is said to be missing', async () => {
    daemon.addScan(1, 'full');
    let answer = (): void => undefined;
    const held = new Promise<void>((go) => (answer = go));
    await page.route('**/api/v1/scans/1/frames*', async (route) => {
      await held;
      await route.continue();
    });
    await page.goto(`${url}/#/result/1/frames`);
    await page.getByText('Reading 336 frames …').waitFor();
    expect(await page.getByText('No frames yet.').count()).toBe(0);
    answer();
    const poses = page.getByTestId('poses');
    await poses.waitFor();
    // On a phone the grid of poses is cut off, with a shadow at its end.
    await page.setViewportSize({ width: 390, height: 800 });
    expect(await poses.evaluate((table) => table.parentElement?.classList.contains('cued'))).toBe(true);
    if (process.env['SHOTS'] !== undefined) await poses.locator('..').screenshot({ path: `${process.env['SHOTS']}/poses.png` });
  });
});

describe('a map', () => {
  it('is not started with an invalid time limit', async () => {
    daemon.addScan(1, 'paper');
    await page.goto(`${url}/#/result/1/map`);
    const limit = page.getByLabel('Time limit of the map, s');
    const begin = page.getByRole('button', { name: 'Map every pixel' });
    for (const wrong of ['-5', 'abc', '0']) {
      await limit.fill(wrong);
      await page.getByText('Time limit: give a number of seconds above 0').waitFor();
      expect(await begin.isDisabled()).toBe(true);
    }
    await limit.fill('0,5');
    await begin.click();
    await expect.poll(() => daemon.requests.find((r) => r.path === '/maps')?.body).toEqual({ scan_id: 1, max_seconds: 0.5 });
  });
});

describe('a frame', () => {
  it('shows the full 16-bit count of the pixel under the cursor, by pointer and by keys', async () => {
    daemon.addScan(1, 'paper');
    await page.goto(`${url}/#/result/1/frames`);
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

  it('is zoomed, and shows the profiles of the pixel that a click keeps', async () => {
    daemon.addScan(1, 'paper');
    await page.goto(`${url}/#/result/1/frames`);
    const canvas = page.getByTestId('frame');
    await expect.poll(() => canvas.evaluate((c) => (c as HTMLCanvasElement).width)).toBe(96);
    const before = await canvas.boundingBox();
    if (!before) throw new Error('the frame is not shown');
    await canvas.click({ position: { x: ((5 + 0.5) / 96) * before.width, y: ((3 + 0.5) / 96) * before.height } });
    await page.getByRole('button', { name: 'Zoom in' }).click();
    await page.getByRole('button', { name: 'Zoom in' }).click();
    expect(await text('[data-testid=zoom]')).toBe('4×');
    expect(await text('[data-testid=pixel]')).toBe('column 5, row 3: 12 345 DN');
    await expect.poll(async () => (await canvas.boundingBox())?.width).toBeCloseTo(4 * before.width, 0);
    const profiles = page.getByTestId('profiles');
    expect(await profiles.getAttribute('aria-label')).toMatch(/^Counts along row 3 and column 5, from /);
    // One point per pixel of the row.
    expect((await profiles.locator('path.row').getAttribute('d'))?.match(/[ML]/g)).toHaveLength(96);
    await page.locator('.stage').focus();
    await page.keyboard.press('-');
    await page.keyboard.press('-');
    expect(await text('[data-testid=zoom]')).toBe('1×');
  });

  it('has its kinds below each other in a narrow window', async () => {
    daemon.addScan(1, 'full');
    await page.setViewportSize({ width: 280, height: 640 });
    await page.goto(`${url}/#/result/1/frames`);
    const kinds = page.getByRole('group', { name: 'Kind of frame' }).getByRole('button');
    await expect.poll(() => kinds.count()).toBe(3);
    for (const kind of await kinds.all()) {
      const box = await kind.boundingBox();
      expect((box?.x ?? 1e9) + (box?.width ?? 0)).toBeLessThanOrEqual(280);
    }
  });

  it('has a region with its statistics, drawn by the pointer and by keys', async () => {
    daemon.addScan(1, 'paper');
    await page.goto(`${url}/#/result/1/frames`);
    const canvas = page.getByTestId('frame');
    await page.getByText('automatic levels').waitFor();
    const box = await canvas.boundingBox();
    if (!box) throw new Error('the frame has no place');
    const at = (column: number, row: number): [number, number] => [box.x + ((column + 0.5) * box.width) / 96, box.y + ((row + 0.5) * box.height) / 96];
    await page.mouse.move(...at(50, 40));
    await page.mouse.down();
    await page.mouse.move(...at(30, 30), { steps: 4 });
    await page.mouse.move(...at(20, 12), { steps: 4 });
    await page.mouse.up();
    await expect.poll(() => text('[data-testid=region]')).toMatch(/^columns 20 to 50, rows 12 to 40: mean [\d ]+\.\d DN, standard deviation [\d.]+ DN, [\d ]+ to [\d ]+ DN, (899|89\d) pixels/);
    // The drag did not keep a pixel.
    await page.mouse.move(...at(70, 70));
    await expect.poll(() => text('[data-testid=pixel]')).toContain('column 70, row 70');
    const stage = page.getByRole('img', { name: /^Frame/ });
    await stage.focus();
    await page.keyboard.press('Delete');
    await expect.poll(() => page.getByTestId('region').count()).toBe(0);
    await page.keyboard.press('Enter');
    for (let i = 0; i < 3; i++) await page.keyboard.press('ArrowLeft');
    await page.keyboard.press('ArrowUp');
    await page.keyboard.press('Enter');
    await page.keyboard.press('ArrowUp');
    await expect.poll(() => text('[data-testid=region]')).toMatch(/^columns 67 to 70, rows 69 to 70: .* 8 pixels; none saturated/);
  });

  it('is shown as the difference from a dark frame, the white reference or another frame', async () => {
    daemon.addScan(1, 'paper');
    await page.goto(`${url}/#/result/1/frames`);
    await page.getByText('automatic levels').waitFor();
    const minus = page.getByRole('combobox', { name: 'Minus' });
    await minus.selectOption('dark frame');
    await expect.poll(() => text('[data-testid=minus]')).toMatch(/^Frame \d+ minus dark frame \d+ at θc 0.0°, φs 0.0°, [\d.]+ m?s\.$/);
    expect(await text('[data-testid=difference-scale]')).toMatch(/^−([\d ]+) \1 DN$/);
    expect(await page.getByText('automatic levels').count()).toBe(0);
    await minus.selectOption('white reference');
    await expect.poll(() => text('[data-testid=minus]')).toContain('minus white reference');
    await minus.selectOption('another frame …');
    await page.getByLabel('Number').fill('7');
    await page.getByText('No frame of this scan has the number 7.').waitFor();
    const shown = Number(await page.getByTestId('frame').getAttribute('data-frame-id'));
    // A frame minus itself is zero everywhere.
    await page.getByLabel('Number').fill(String(shown));
    await page.getByTestId('difference-scale').waitFor();
    const box = await page.getByTestId('frame').boundingBox();
    await page.mouse.move((box?.x ?? 0) + 40, (box?.y ?? 0) + 40);
    await expect.poll(() => text('[data-testid=pixel]')).toMatch(/: 0 DN$/);
    await minus.selectOption('nothing');
    await page.getByText('automatic levels').waitFor();
  });

  it('of a large camera is a picture until its counts are asked for', async () => {
    daemon.statedPx = 4000;
    daemon.addScan(1, 'paper');
    await page.goto(`${url}/#/result/1/frames`);
    await page.getByText('A click reads the counts of this frame.').waitFor();
    const files = (): string[] => daemon.reads.filter((path) => path.endsWith('/image.png'));
    expect(daemon.reads.some((path) => path.endsWith('/preview.png?width=512'))).toBe(true);
    expect(files()).toEqual([]);
    await page.getByRole('button', { name: 'Read the counts' }).click();
    await page.getByText('Point at a pixel for its counts').waitFor();
    expect(files()).toHaveLength(1);
    await page.getByRole('img', { name: /^Histogram of the counts/ }).waitFor();
  });

  it('marks saturated pixels only if the option is set', async () => {
    daemon.addScan(1, 'full');
    await page.goto(`${url}/#/result/1/frames`);
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
    await page.getByLabel('mark saturated and defect pixels').uncheck();
    await expect.poll(red).toBe(0);
  });
});

describe('the map of poses', () => {
  it('is one stop of the Tab key, follows the arrow keys, and has a colour scale', async () => {
    daemon.addScan(1, 'full');
    await page.goto(`${url}/#/result/1/frames`);
    const poses = page.getByTestId('poses');
    await poses.waitFor();
    await expect.poll(() => poses.locator('button[tabindex="0"]').count()).toBe(1);
    await expect.poll(() => poses.locator('button').count()).toBe(108);
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
