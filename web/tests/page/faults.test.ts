// What the page shows of refusals, alarms, lost links and silence.

import { describe, expect, it } from 'vitest';

import { anotherDaemon, chooseSample, daemon, page, posts, text, url } from './stage';

describe('faults', () => {
  it('shows a refusal as a sentence that can be closed', async () => {
    daemon.addScan(1, 'paper');
    daemon.refusals.set('POST /fits', { status: 507, body: { code: 'disk-full', title: 'no room', detail: 'the disk of /data has 3 MB left: remove something or move the store' } });
    await page.goto(`${url}/#/result`);
    await page.getByRole('button', { name: 'Fit', exact: true }).click();
    const alert = page.getByRole('alert').filter({ hasText: 'The disk of /data has 3 MB left: remove something or move the store.' });
    await alert.waitFor();
    await alert.getByRole('button', { name: 'Close' }).click();
    await alert.waitFor({ state: 'detached' });
  });

  it('requests an estimate once, not at every event of the rig', async () => {
    await page.goto(url);
    await chooseSample();
    await page.getByText('53 frames').waitFor();
    for (let i = 0; i < 5; i++) {
      daemon.event('rig', {});
      await page.waitForTimeout(150);
    }
    expect(daemon.requests.filter((r) => r.path === '/scans/estimate')).toHaveLength(1);
  });

  it('shows why a plan cannot run before it is started', async () => {
    await page.goto(url);
    await chooseSample();
    await page.getByText('custom', { exact: true }).click();
    await page.getByLabel(/Camera tilts/).fill('0, 75');
    await page.getByText('75° is not within −60° to 60°.').waitFor();
    expect(await page.getByRole('button', { name: 'Start scan' }).isDisabled()).toBe(true);
    // The page knows these limits; what only the daemon knows, it is asked.
    expect(daemon.requests.filter((r) => r.path === '/scans/estimate' && JSON.stringify(r.body).includes('75'))).toEqual([]);
    daemon.refusals.set('POST /scans/estimate', { status: 422, body: { code: 'invalid-value', title: 'a value is not valid', detail: 'a path enters the forbidden region of the lens' } });
    await page.getByLabel(/Camera tilts/).fill('0, 50');
    await page.getByText('a path enters the forbidden region of the lens').waitFor();
    expect(await page.getByRole('button', { name: 'Start scan' }).isDisabled()).toBe(true);
  });

  it('shows each warning of an axis once', async () => {
    daemon.axes.theta_c.warnings = ['WR: no reference position; home the axis'];
    await page.goto(`${url}/#/rig`);
    await expect.poll(() => text('[data-axis=theta_c] .warning')).toBe('WR no reference position; home the axis');
  });

  it('names a missing port, and reconnects by its button, by homing or by a start', async () => {
    daemon.connected = false;
    daemon.plugged = false;
    await page.goto(`${url}/#/rig`);
    await page.getByText('The serial port /dev/ttyUSB0 does not exist').waitFor();
    expect(await page.getByRole('button', { name: /STOP/ }).isEnabled()).toBe(true);
    // Without a connection, motion and position are unknown.
    expect(await page.locator('[data-axis] .chip').allInnerTexts()).toEqual(['unknown', 'unknown']);
    const tilt = page.locator('[data-axis=theta_c]');
    expect(await tilt.getByLabel('camera tilt: move to, degrees').isDisabled()).toBe(true);
    const again = page.getByRole('button', { name: 'Reconnect' });
    await again.click();
    await page.getByText('Still not connected.').waitFor();
    daemon.plugged = true;
    await again.click();
    await page.getByText('at rest').waitFor();
    expect(await again.count()).toBe(0);
    // It is no stop, which would pause the queue and raise an alarm.
    expect(posts()).toEqual([]);
    for (const view of ['rig', 'measure']) {
      await page.goto(`${url}/#/${view}`);
      if (view === 'measure') await chooseSample();
      const press = view === 'rig' ? tilt.getByRole('button', { name: 'Home' }) : page.getByRole('button', { name: 'Start scan' });
      await expect.poll(() => press.isEnabled()).toBe(true);
      [daemon.connected, daemon.plugged] = [false, false];
      daemon.event('rig', {});
      await page.getByText('stages not connected').waitFor();
      daemon.plugged = true;
      await press.click();
      await page.getByText('stages not connected').waitFor({ state: 'detached' });
    }
    expect(posts()).toEqual(['/rig/axes/theta_c/home', '/scans']);
  });

  it('says of a specification that its limits are the wrong way round', async () => {
    await page.goto(`${url}/#/setup`);
    await page.getByRole('button', { name: 'New specification' }).click();
    const form = page.getByTestId('specification-form');
    await form.getByLabel(/^Name/).fill('drawing 8');
    await form.getByLabel('ridge angle: lower limit').fill('11');
    await form.getByLabel('ridge angle: upper limit').fill('9');
    await form.getByRole('button', { name: 'Save the specification' }).click();
    await form.getByRole('alert').getByText('Ridge angle: the lower limit is above the upper one.').waitFor();
    expect(posts()).toEqual([]);
  });

  it('says beside the field that an exposure is unusual', async () => {
    await page.goto(url);
    await chooseSample();
    const field = page.getByLabel('Exposures, ms');
    await field.fill('20000');
    await page.getByText('20 s is an unusually long exposure.').waitFor();
    await field.fill('0.02');
    await page.getByText('0.02 ms is an unusually short exposure.').waitFor();
    await field.fill('20, 60');
    await page.getByText('unusually').waitFor({ state: 'detached' });
  });

  it('keeps the camera during a scan with the reason why it takes no picture, and lists alarms after they are dismissed', async () => {
    daemon.frameMs = 200;
    await page.goto(url);
    await chooseSample();
    await page.getByRole('button', { name: 'Start scan' }).click();
    await page.getByRole('button', { name: 'Continue' }).waitFor();
    await page.goto(`${url}/#/rig`);
    const camera = page.getByTestId('camera');
    await camera.getByText('No picture can be taken now. Scan 1 uses the camera. Its newest frame is in Measure.').waitFor();
    expect(await camera.getByRole('button', { name: 'Take a look' }).isDisabled()).toBe(true);
    const events = page.getByTestId('rig-events');
    await events.getByText('No alarm in the newest scans').waitFor();
    daemon.event('alarm', { code: 'disk-low', message: 'the disk has 90 MB left', scan_id: null });
    await page.getByRole('button', { name: 'Seen' }).click();
    await events.getByText('The disk has 90 MB left.').waitFor();
    await events.getByText('disk-low').waitFor();
  });

  it('shows an alarm until it is dismissed', async () => {
    await page.goto(url);
    await page.getByText('at rest').waitFor();
    await expect.poll(async () => {
      daemon.event('alarm', { code: 'stage-stalled', message: 'the tilt axis stalled at 12.3°', scan_id: null });
      return page.getByText('The tilt axis stalled at 12.3°.').count();
    }).toBeGreaterThan(0);
    for (let n = await page.getByRole('button', { name: 'Seen' }).count(); n > 0; n--) await page.getByRole('button', { name: 'Seen' }).first().click();
    expect(await page.getByText('The tilt axis stalled at 12.3°.').count()).toBe(0);
  });

  it('keeps every alarm until it is seen or has ended, and counts those in the same words', async () => {
    daemon.frameMs = 100;
    await page.goto(url);
    await chooseSample();
    await page.getByRole('button', { name: 'Start scan' }).click();
    await page.getByRole('button', { name: 'Continue' }).click();
    const alarms = page.locator('.messages').getByText('Alarm,');
    for (let n = 1; n <= 7; n++) daemon.event('alarm', { code: 'disk-low', message: `the disk has ${n} MB left`, scan_id: null });
    await expect.poll(() => alarms.count()).toBe(7);
    for (let n = 0; n < 4; n++) daemon.event('alarm', { code: 'no-frame', message: 'the camera sent no frame', scan_id: 1 });
    await page.locator('.messages').getByText(/, ×4\./).waitFor();
    expect(await alarms.count()).toBe(8);
    // Another fault of the scan is over once it recovered.
    daemon.event('alarm', { code: 'lamp-dim', message: 'the lamp is dim', scan_id: 1 });
    await page.getByText('The lamp is dim.').waitFor();
    daemon.event('recovered', { code: 'lamp-dim', message: 'the lamp is as before', scan_id: 1, took_s: 2, points: [], attended: false });
    await page.getByText('The lamp is dim.').waitFor({ state: 'detached' });
    expect(await alarms.count()).toBe(8);
    // A stop by key says that the scan is paused, until it is not.
    await page.getByRole('button', { name: 'Continue' }).waitFor();
    await page.getByRole('button', { name: 'Continue' }).click();
    await page.getByText('scanning').waitFor();
    await page.keyboard.press('Escape');
    const stopped = page.getByText('The scan is paused. Press Resume to continue it.');
    await stopped.waitFor();
    await page.getByText('scan paused', { exact: true }).waitFor();
    expect(await stopped.count()).toBe(1);
    await page.getByRole('button', { name: 'Resume' }).click();
    await stopped.waitFor({ state: 'detached' });
    // What stopped the scan is over when it runs again.
    await expect.poll(() => alarms.count()).toBe(7);
  });

  it('keeps the plots if one reading fails, says so, and reads again', async () => {
    daemon.addScan(1, 'paper');
    let fail = false;
    await page.route('**/observations*', (route) => (fail ? route.fulfill({ status: 500, json: { code: 'internal', detail: 'the store is busy' } }) : route.continue()));
    await page.goto(`${url}/#/result/1`);
    await page.locator('[data-testid=curves] canvas').first().waitFor();
    fail = true;
    // The scan changes its state, so that its observations are read again.
    daemon.scans[0]!.body.state = 'aborted';
    daemon.event('scan', { scan_id: 1, sample_id: 1, state: 'aborted', reason: null, operator: null, progress: null });
    const stale = page.getByTestId('stale');
    await stale.getByText('The last reading failed; the plots show the one before. The store is busy.').waitFor();
    expect(await page.locator('[data-testid=curves] canvas').count()).toBeGreaterThan(0);
    fail = false;
    await stale.getByRole('button', { name: 'Read again' }).click();
    await stale.waitFor({ state: 'detached' });
    // A link that is live again reads by itself.
    fail = true;
    daemon.scans[0]!.body.state = 'completed';
    daemon.event('scan', { scan_id: 1, sample_id: 1, state: 'completed', reason: null, operator: null, progress: null });
    await stale.waitFor();
    fail = false;
    daemon.dropStreams();
    await stale.waitFor({ state: 'detached' });
  });

  it('is live again after requests failed while the stream of events stayed open', async () => {
    await page.goto(url);
    await page.getByText('at rest').waitFor();
    await page.route('**/api/v1/rig', (route) => route.abort());
    await page.getByText('The daemon cannot be reached.').waitFor();
    await page.unroute('**/api/v1/rig');
    await page.getByText('at rest').waitFor();
    await page.getByText('The daemon cannot be reached.').waitFor({ state: 'detached' });
  });

  it('says so on a silent line: of a stop within seconds, and of the rig', async () => {
    await page.goto(url);
    await page.getByText('at rest').waitFor();
    const silent: (() => Promise<void>)[] = [];
    await page.route(/\/api\/v1\/rig(\/stop)?$/, (route) => new Promise<void>((resolve) => silent.push(async () => { await route.continue(); resolve(); })));
    await page.keyboard.press('Escape');
    const warning = page.getByText('The stop has no answer yet. If anything moves, use the rig’s emergency switch.');
    await warning.waitFor({ timeout: 6000 });
    expect(posts()).not.toContain('/rig/stop');
    await page.getByText('The daemon cannot be reached.').waitFor({ timeout: 20_000 });
    // The line is back: the stop still arrives, and the page is live.
    await page.unroute(/\/api\/v1\/rig(\/stop)?$/, undefined);
    for (const answer of silent) await answer().catch(() => undefined);
    await expect.poll(posts).toContain('/rig/stop');
    await warning.waitFor({ state: 'detached' });
    await page.getByText('at rest').waitFor();
  });

  it('says what it reads while the daemon is slow, and nothing of the stages before it knows', async () => {
    daemon.addFit(daemon.addScan(1, 'full'));
    let answer = (): void => undefined;
    const answers = new Promise<void>((go) => (answer = go));
    await page.route(/\/api\/v1\/(?!events|session)/, async (route) => {
      await answers;
      await route.fallback();
    });
    await page.goto(url);
    await page.locator('main').getByText('Reading the scans …').waitFor();
    expect(await page.locator('header').getByText('connecting').count()).toBe(1);
    answer();
    await page.getByText('Last results').waitFor();
    await page.locator('header').getByText('connecting').waitFor({ state: 'detached' });
  });

  it('reconnects to a restarted daemon and shows what happened meanwhile', async () => {
    await page.goto(url);
    await page.getByText('at rest').waitFor();
    const port = Number(new URL(url).port);
    await daemon.stop();
    await page.getByText('The daemon cannot be reached.').waitFor();
    const again = anotherDaemon();
    again.addFit(again.addScan(2, 'paper'));
    await again.start(port);
    await page.getByText('at rest').waitFor();
    await expect.poll(() => text('[data-parameter=theta_r_deg]')).toBe('15.031 ± 0.085°');
  });
});
