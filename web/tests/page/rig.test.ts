// Commands to the rig: the stop, moves by hand, and axes without a position.

import { describe, expect, it } from 'vitest';

import { chooseSample, daemon, page, posts, text, url } from './stage';

describe('stop', () => {
  it('is sent by click and by Escape, also from inside a field', async () => {
    await page.goto(`${url}/#/rig`);
    await page.getByRole('button', { name: /STOP/ }).click();
    await expect.poll(posts).toEqual(['/rig/stop']);
    await page.getByLabel('camera tilt: move to, degrees').focus();
    await page.keyboard.press('Escape');
    await expect.poll(posts).toEqual(['/rig/stop', '/rig/stop']);
  });

  it('raises an alert if it did not reach the stages', async () => {
    daemon.refusals.set('POST /rig/stop', { status: 503, body: { code: 'stage-no-reply', title: 'no reply', detail: 'the controller does not answer' } });
    await page.goto(url);
    await page.keyboard.press('Escape');
    await page.getByRole('alert').filter({ hasText: 'Use the rig’s emergency switch. The controller does not answer.' }).waitFor();
  });

  it('by the key says what it stopped, since a key is pressed by mistake', async () => {
    daemon.frameMs = 100;
    await page.goto(url);
    await page.keyboard.press('Escape');
    await expect.poll(posts).toEqual(['/rig/stop']);
    await chooseSample();
    await page.getByRole('button', { name: 'Start scan' }).click();
    for (let i = 0; i < 3; i++) await page.getByRole('button', { name: 'Continue' }).click();
    await page.locator('header').getByText('scanning').waitFor();
    // The first one stopped nothing.
    expect(await page.getByText('The key Esc stopped').count()).toBe(0);
    await page.keyboard.press('Escape');
    await page.getByRole('alert').getByText('The key Esc stopped both axes. The scan is paused. Press Resume to continue it.').waitFor();
    await page.getByRole('button', { name: 'Resume' }).waitFor();
  });

  it('by the key says so until the scan continues, also if the scan pauses before the answer comes', async () => {
    daemon.frameMs = 100;
    await page.route('**/rig/stop', async (route) => {
      const answer = await route.fetch();
      await page.locator('header').getByText('scan paused', { exact: true }).waitFor();
      await route.fulfill({ response: answer });
    });
    await page.goto(url);
    await chooseSample();
    await page.getByRole('button', { name: 'Start scan' }).click();
    for (let i = 0; i < 3; i++) await page.getByRole('button', { name: 'Continue' }).click();
    await page.locator('header').getByText('scanning').waitFor();
    await page.keyboard.press('Escape');
    const stopped = page.getByText('The scan is paused. Press Resume to continue it.');
    await stopped.waitFor();
    daemon.frameMs = 60_000;
    await page.getByRole('button', { name: 'Resume' }).click();
    await stopped.waitFor({ state: 'detached' });
  });

  it('stays visible on a narrow screen while scrolling', async () => {
    daemon.addFit(daemon.addScan(1, 'full'));
    await page.setViewportSize({ width: 390, height: 700 });
    await page.goto(`${url}/#/result/1/uncertainty`);
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
  it('refuses an angle beyond the travel without a request', async () => {
    await page.goto(`${url}/#/rig`);
    await page.getByLabel('camera tilt: move to, degrees').fill('75');
    expect(await page.getByText('Between −60° and 60°.').isVisible()).toBe(true);
    expect(await page.locator('[data-axis=theta_c]').getByRole('button', { name: 'Move', exact: true }).isDisabled()).toBe(true);
    expect(posts()).toEqual([]);
  });

  it('sends the angle typed with a comma or a true minus', async () => {
    await page.goto(`${url}/#/rig`);
    await page.getByLabel('camera tilt: move to, degrees').fill('−12,5');
    await page.locator('[data-axis=theta_c]').getByRole('button', { name: 'Move', exact: true }).click();
    await expect.poll(() => daemon.requests.find((r) => r.path.startsWith('/rig'))).toEqual({ method: 'POST', path: '/rig/axes/theta_c/move', body: { position_deg: -12.5 } });
    await expect.poll(() => text('[data-axis=theta_c] output')).toBe('−12.500°');
  });
});

describe('axes that are not homed', () => {
  it('have no position', async () => {
    for (const axis of Object.values(daemon.axes)) Object.assign(axis, { position_deg: -65, homed: false, referenced: false });
    await page.goto(`${url}/#/rig`);
    await expect.poll(() => text('[data-axis=theta_c] output')).toBe('position unknown – home the axis');
    await page.locator('header').getByText('position unknown – home the axes').waitFor();
    await expect.poll(() => page.locator('header .dot.warn').count()).toBe(1);
    expect(await page.getByText('65.000').count()).toBe(0);
    expect(await page.locator('[data-axis=theta_c] .marker').count()).toBe(0);
    await page.locator('[data-axis=theta_c]').getByRole('button', { name: 'Home' }).click();
    await expect.poll(() => text('[data-axis=theta_c] output')).toBe('0.000°');
  });
});
