// The page with a mock daemon: rig, scans, faults, and rules for every card.

import { describe, expect, it } from 'vitest';

import { anotherDaemon, chooseSample, daemon, page, posts, text, url } from './stage';

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

describe('a scan', () => {
  it('shows its operator steps, counts its frames and is fitted', async () => {
    await page.goto(url);
    await page.getByRole('combobox', { name: /^Part/ }).selectOption({ label: 'model 15° (n 1.54)' });
    await page.getByRole('button', { name: 'Start scan' }).click();
    for (const step of ['Cap the lens', 'Place the white reference', 'Place the part model 15°']) {
      await page.getByRole('heading', { name: step }).waitFor();
      await page.getByRole('button', { name: 'Continue' }).click();
    }
    await page.getByText('Not fitted yet.').waitFor();
    await page.getByRole('link', { name: 'Open the result' }).click();
    await page.getByRole('button', { name: 'Fit', exact: true }).click();
    await expect.poll(() => text('[data-parameter=theta_r_deg]')).toBe('15.031 ± 0.085°');
    expect(posts()).toEqual(['/scans', ...Array(3).fill('/scans/1/continue'), '/fits']);
    // Each confirmation names its step, since the scan may already wait for another one.
    const said = daemon.requests.filter((r) => r.path === '/scans/1/continue').map((r) => r.body);
    expect(said).toEqual([{ action: 'cap-lens' }, { action: 'place-white-reference' }, { action: 'place-sample' }]);
  });

  it('that was interrupted is resumed where the page says so', async () => {
    daemon.addScan(1, 'paper');
    Object.assign(daemon.scans[0]?.body ?? {}, { state: 'interrupted', reason: 'the daemon was stopped; resume the scan to continue' });
    await page.goto(url);
    await page.getByText('The daemon was stopped; resume the scan to continue.').waitFor();
    await page.getByRole('button', { name: 'Resume scan' }).click();
    await expect.poll(posts).toEqual(['/scans/1/resume']);
    await page.getByRole('button', { name: 'Resume scan' }).waitFor({ state: 'detached' });
  });

  it('takes no command while the daemon is lost', async () => {
    await page.goto(url);
    await chooseSample();
    await page.getByRole('button', { name: 'Start scan' }).click();
    await page.getByRole('heading', { name: 'Cap the lens' }).waitFor();
    const abort = page.getByRole('button', { name: 'Abort …' });
    expect(await abort.isEnabled()).toBe(true);
    await daemon.stop();
    await expect.poll(() => abort.isDisabled()).toBe(true);
    expect(await page.getByRole('button', { name: /STOP/ }).isEnabled()).toBe(true);
    expect(await page.locator('header .readout .value').allInnerTexts()).toEqual(['–', '–']);
  });

  it('shows frames of a fast rig in groups, a few times a second, and misses none', async () => {
    await page.goto(url);
    await chooseSample();
    await page.getByText('full', { exact: true }).click();
    await page.getByRole('button', { name: 'Start scan' }).click();
    await page.getByRole('heading', { name: 'Cap the lens' }).waitFor();
    await page.goto(`${url}/#/result/1/frames`);
    for (let i = 0; i < 3; i++) await page.getByRole('button', { name: 'Continue' }).click();
    // Number of changes of the sample frame count, up to the last.
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
    // Four a second, and one at each change of the scan's state.
    expect(changes).toBeLessThanOrEqual(4 * seconds + 10);
    const { n } = await page.evaluate(async () => ({ n: ((await (await fetch('/api/v1/scans/1/frames?limit=1000')).json()) as { items: unknown[] }).items.length }));
    const shown = (await text('.kinds')).match(/\d+/g)?.reduce((sum, k) => sum + Number(k), 0);
    expect(shown).toBe(n);
  });

  it('pauses, resumes and is aborted only when confirmed', async () => {
    // 336 frames, so that the scan does not end before the test.
    daemon.frameMs = 100;
    await page.goto(url);
    await chooseSample();
    await page.getByText('full', { exact: true }).click();
    await page.getByRole('button', { name: 'Start scan' }).click();
    for (let i = 0; i < 3; i++) await page.getByRole('button', { name: 'Continue' }).click();
    await page.getByRole('button', { name: 'Pause' }).click();
    await page.getByRole('button', { name: 'Resume' }).click();
    await page.getByRole('button', { name: 'Abort …' }).click();
    await page.getByRole('button', { name: 'Do not abort' }).click();
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

  it('can be started only with an estimate, whose text moves the button', async () => {
    let answer = (): void => undefined;
    const held = new Promise<void>((go) => (answer = () => go()));
    await page.route('**/scans/estimate', async (route) => {
      await held;
      await route.continue();
    });
    await page.goto(url);
    await chooseSample();
    await start().waitFor();
    expect(await start().isDisabled()).toBe(true);
    answer();
    // As slow as a user.
    await start().click({ delay: 150 });
    await expect.poll(plan).toEqual({ preset: 'paper', repeats: 1 });
  });

  it('warns of a grid with too few poses for a fit', async () => {
    await page.goto(url);
    await chooseSample();
    await page.getByText('53 frames').waitFor();
    expect(await page.getByTestId('few-poses').count()).toBe(0);
    await page.getByText('custom', { exact: true }).click();
    await page.getByLabel(/Camera tilts/).fill('0');
    await page.getByLabel(/Sample azimuths/).fill('0, 90');
    await expect.poll(() => page.getByTestId('few-poses').innerText()).toBe('2 poses are too few: a fit needs at least 9 poses.');
    // A scan of few poses may have another purpose.
    await expect.poll(() => start().isDisabled()).toBe(false);
  });

  it('does not misread a decimal comma, and shows what it read', async () => {
    await page.goto(url);
    await chooseSample();
    await page.getByText('53 frames').waitFor();
    await page.getByLabel('Repeats').fill('1,5');
    await page.getByText('Give a whole number from 1 to 100.').waitFor();
    expect(await start().isDisabled()).toBe(true);
    await page.getByLabel('Repeats').fill('2');
    await page.getByLabel('Exposures, ms').fill('2,5');
    await page.getByText('“2,5” is ambiguous').waitFor();
    expect(await start().isDisabled()).toBe(true);
    await page.getByLabel('Exposures, ms').fill('2, 5');
    await expect.poll(() => text('[data-testid=readings]')).toBe('2 exposures: 2 ms, 5 ms');
    await start().click();
    await expect.poll(plan).toEqual({ preset: 'paper', repeats: 2, exposures_s: [0.002, 0.005] });
  });

  it('names the calibrations that it would reuse, and takes new ones if chosen', async () => {
    daemon.calibrations.push({ id: 8, kind: 'flat', scan_id: 1, created_at: new Date(2026, 0, 2, 17, 34).toISOString() }, { id: 7, kind: 'dark', scan_id: 1, created_at: new Date(2026, 0, 2, 17, 31).toISOString() });
    await page.goto(url);
    await chooseSample();
    const card = page.getByTestId('calibrations');
    await card.getByText('Reused: white reference of scan 1 (2026-01-02 17:34), dark frames of scan 1 (2026-01-02 17:31).').waitFor();
    await card.getByLabel('take new dark frames').check();
    await card.getByText('Used again').waitFor({ state: 'detached' });
    await start().click();
    await expect.poll(plan).toEqual({ preset: 'paper', repeats: 1, reuse_calibrations: false });
  });

  it('shows why calibrations were interrupted, and resumes them', async () => {
    const id = daemon.addScan(1, 'paper');
    const scan = daemon.scans.find((s) => s.body.id === id);
    Object.assign(scan?.body ?? {}, { state: 'interrupted', reason: 'the daemon was stopped; resume the scan to continue', plan: { ...scan?.body.plan, repeats: 0 } });
    await page.goto(`${url}/#/result`);
    await page.getByRole('heading', { level: 1, name: 'Calibration' }).waitFor();
    await page.getByText('the daemon was stopped; resume the scan to continue').first().waitFor();
    await page.getByText('Neither the dark frames nor the white reference are complete, so scans do not use them.').waitFor();
    await page.getByRole('button', { name: 'Resume scan' }).click();
    await expect.poll(posts).toContain(`/scans/${id}/resume`);
  });

  it('adds a plastic with its uncertainty and a metal by its name, and reports faults beside their fields', async () => {
    const sent = (): unknown => daemon.requests.findLast((r) => r.path === '/samples')?.body;
    await page.goto(url);
    const sample = page.getByRole('combobox', { name: /^Part/ });
    await sample.selectOption({ label: 'New part …' });
    const form = page.getByTestId('sample-form');
    await form.getByLabel('Name', { exact: true }).fill('model 15°');
    await form.getByText('There is a part of this name already, no. 2.').waitFor();
    await form.getByLabel('Index n', { exact: true }).fill('abc');
    await form.getByText('“abc” is not a number.').waitFor();
    await form.getByRole('button', { name: 'Add part' }).click();
    expect(posts()).toEqual([]);
    await form.getByLabel('Index n', { exact: true }).fill('1,49');
    await form.getByLabel('Standard uncertainty of n').fill('0,02');
    await form.getByRole('button', { name: 'Add part' }).click();
    await expect.poll(sent).toEqual({ name: 'model 15°', material: { kind: 'dielectric', eta: 1.49, eta_std: 0.02 } });
    await expect.poll(() => sample.locator('option:checked').innerText()).toBe('model 15° (n 1.49)');
    await sample.selectOption({ label: 'New part …' });
    await form.getByLabel('Name', { exact: true }).fill('die 4');
    await form.getByLabel('Material').selectOption('metal');
    await form.getByRole('combobox', { name: 'Metal', exact: true }).selectOption('Cu');
    await form.getByRole('button', { name: 'Add part' }).click();
    await expect.poll(sent).toEqual({ name: 'die 4', metal: { name: 'Cu' } });
    await expect.poll(() => sample.locator('option:checked').innerText()).toBe('die 4 (n 3.12, κ 3.33)');
  });
});

describe('the part of the next scan', () => {
  const chosen = (): Promise<string> => page.getByRole('combobox', { name: /^Part/ }).locator('option:checked').innerText();

  it('is asked for before the first scan, and an import does not change it', async () => {
    await page.goto(url);
    await expect.poll(chosen).toBe('Which part is on the table?');
    expect(await page.getByRole('button', { name: 'Start scan' }).isDisabled()).toBe(true);
    daemon.addScan(2, 'paper');
    await page.reload();
    await expect.poll(chosen).toBe('model 15° (n 1.54)');
    const imported = daemon.addScan(daemon.addSample('polymer-10', { theta_r_deg: 10, alpha_u: 0.1, alpha_v: 0.1, rho_d: 0.3 }), 'paper');
    Object.assign(daemon.scans.find((s) => s.body.id === imported)?.body ?? {}, { origin: 'import' });
    await page.reload();
    await expect.poll(chosen).toBe('model 15° (n 1.54)');
  });

  it('is renamed, and a scan is assigned to another one, both with their trace', async () => {
    daemon.addScan(1, 'paper');
    await page.goto(url);
    await page.getByRole('button', { name: 'Rename …' }).click();
    await page.getByLabel('New name of the part').fill('B-17');
    await page.keyboard.press('Enter');
    await page.getByRole('heading', { level: 1, name: 'B-17' }).waitFor();
    await page.getByText(/before: traced polymer \(until/).waitFor();
    await page.getByRole('link', { name: 'Open the result' }).click();
    await page.getByRole('button', { name: 'Other part …' }).click();
    await page.locator('.sample select').selectOption({ label: 'model 15° (n 1.54)' });
    await page.getByRole('heading', { level: 1, name: 'model 15°' }).waitFor();
    await page.getByText(/Assigned to B-17 until/).waitFor();
    expect(daemon.requests.filter((r) => r.method === 'PATCH').map((r) => [r.path, r.body])).toEqual([['/samples/1', { name: 'B-17' }], ['/scans/1', { sample_id: 2 }]]);
    // Enter in the field has not started a scan.
    expect(daemon.requests.filter((r) => r.path === '/scans')).toEqual([]);
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

describe('the answer', () => {
  const row = (id: number, std: number) => ({ id, elapsed_s: 10 * id, n_observations: 3 * id, n_frames_used: 9 * id, variant: 'sawtooth', status: 'converged', parameters: { theta_r_deg: { value: 10.031, std } } });

  it('shows the value so far until there is a fit, and never that it is not fitted', async () => {
    daemon.certainties.push(row(1, 0.1), row(2, 0.05));
    daemon.addScan(1, 'paper');
    await page.goto(url);
    await expect.poll(() => text('[data-so-far=theta_r_deg]')).toBe('10.03 ± 0.10°');
    expect(await page.getByText('Not fitted yet').count()).toBe(0);
    await page.getByText('ridge angle, so far').waitFor();
    daemon.addFit(1);
    await expect.poll(() => text('[data-parameter=theta_r_deg]')).toBe('10.031 ± 0.085°');
    expect(await page.getByTestId('so-far').count()).toBe(0);
  });

  it('has the coverage factor of the newest row', async () => {
    const early = row(1, 0.1);
    daemon.certainties.push({ ...early, parameters: { theta_r_deg: { ...early.parameters.theta_r_deg, coverage_factor: 4.527 }, rho_d: { value: 0.337, std: 0.002, coverage_factor: 2.13 } } });
    daemon.addScan(1, 'paper');
    await page.goto(url);
    await expect.poll(() => text('[data-so-far=theta_r_deg]')).toBe('10.03 ± 0.45° k = 4.53');
    await page.getByText('± is the expanded uncertainty, k = 2.13 … 4.53 · fitted during the scan').waitFor();
  });

  it('offers the report of the fit, to print and as JSON', async () => {
    const fit = daemon.addFit(daemon.addScan(1, 'paper'));
    await page.goto(`${url}/#/result/1`);
    const report = page.getByRole('link', { name: 'Report', exact: true });
    expect(await report.getAttribute('href')).toBe(`/api/v1/scans/1/report?fit_id=${fit}&format=html`);
    expect(await page.getByRole('link', { name: 'as JSON', exact: true }).getAttribute('href')).toBe(`/api/v1/scans/1/report?fit_id=${fit}&format=json`);
  });

  it('follows a scan that the daemon fits by itself', async () => {
    daemon.fitsAtEnd = true;
    await page.goto(url);
    await chooseSample();
    await page.getByRole('button', { name: 'Start scan' }).click();
    for (let i = 0; i < 3; i++) await page.getByRole('button', { name: 'Continue' }).click();
    await expect.poll(() => text('[data-parameter=theta_r_deg]')).toBe('10.031 ± 0.085°');
    expect(posts()).not.toContain('/fits');
  });

  it('says after an abort why there is none', async () => {
    daemon.addScan(1, 'paper');
    Object.assign(daemon.scans[0]?.body ?? {}, { state: 'interrupted', reason: 'the daemon was stopped; resume the scan to continue' });
    await page.goto(url);
    await page.getByText('The scan is interrupted: The daemon was stopped; resume the scan to continue.').waitFor();
  });

  it('states the state of the scan as the bar does, while it is paused and while it waits', async () => {
    daemon.frameMs = 100;
    await page.goto(url);
    await chooseSample();
    await page.getByRole('button', { name: 'Start scan' }).click();
    const answer = page.locator('section[aria-labelledby=answer-title]');
    await answer.getByText('Scan waiting for you: 0 of 53 frames.').waitFor();
    for (let i = 0; i < 3; i++) await page.getByRole('button', { name: 'Continue' }).click();
    await answer.getByText(/Scan running: \d+ of 53 frames. The first result follows after a few poses./).waitFor();
    await page.getByRole('button', { name: 'Pause' }).click();
    await page.locator('header').getByText('scan paused').waitFor();
    await answer.getByText(/Scan paused: \d+ of 53 frames\.$/).waitFor();
    expect(await answer.getByText('running').count()).toBe(0);
  });

  it('does not offer to fit a scan without a frame of the part', async () => {
    daemon.addScan(1, 'paper');
    Object.assign(daemon.scans[0]?.body ?? {}, { state: 'aborted', reason: null, progress: { phase: 'dark', shots_done: 0, shots_total: 53, frames_done: 0, frames_total: 53, fraction: 0, elapsed_s: 2, time_left_s: null } });
    await page.goto(url);
    await page.getByText('The scan is aborted. It has no frame of the part, so there is nothing to fit.').waitFor();
    Object.assign(daemon.scans[0]?.body ?? {}, { reason: 'ended by Ada' });
    await page.reload();
    await page.getByText('The scan is aborted: Ended by Ada. It has no frame of the part, so there is nothing to fit.').waitFor();
  });

  it('says when the target of the user is reached', async () => {
    daemon.certainties.push(row(1, 0.1), row(2, 0.05), row(3, 0.04));
    daemon.addScan(1, 'paper');
    await page.goto(`${url}/#/result/1/uncertainty`);
    const card = page.getByTestId('certainty');
    const field = card.getByLabel('Target: expanded uncertainty of the ridge angle, degrees');
    await field.fill('0.05');
    await expect.poll(() => text('[data-testid=target]')).toBe('target not reached U(θr) is 0.080°, above the target of 0.05°.');
    await field.fill('0,1');
    await expect.poll(() => text('[data-testid=target]')).toBe('target reached after 6 poses.');
    await field.fill('-1');
    await card.getByText('Target: give an angle above 0°').waitFor();
    await field.fill('0.1');
    await page.reload();
    await expect.poll(() => text('[data-testid=target]')).toBe('target reached after 6 poses.');
  });
});

describe('the curves of a running scan', () => {
  it('have the panels of the plan from the first second on', async () => {
    daemon.frameMs = 100;
    await page.goto(url);
    await chooseSample();
    await page.getByRole('button', { name: 'Start scan' }).click();
    await page.getByRole('heading', { name: 'Cap the lens' }).waitFor();
    await expect.poll(() => page.getByTestId('curves').locator('figure').count()).toBe(5);
    expect(await page.getByText('No observations').count()).toBe(0);
  });
});

describe('an address of a missing scan or fit', () => {
  it('shows nothing in its place, and links to existing ones', async () => {
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

describe('a step that waits', () => {
  it.each([1280, 400])('stays in view however far one scrolls, %i pixels wide, and leaves the page room', async (width) => {
    daemon.addFit(daemon.addScan(1, 'full'));
    await page.setViewportSize({ width, height: 700 });
    await page.goto(url);
    await page.getByRole('button', { name: 'Start scan' }).click();
    await page.getByRole('heading', { name: 'Cap the lens' }).waitFor();
    await page.goto(`${url}/#/result/1/uncertainty`);
    await page.getByTestId('parameters').waitFor();
    await page.locator('header').getByText('waits for you: cap the lens').waitFor();
    await page.evaluate(() => scrollTo(0, document.body.scrollHeight));
    const box = await page.getByRole('button', { name: 'Continue' }).boundingBox();
    expect(box?.y ?? -1).toBeGreaterThan(350);
    expect((box?.y ?? 1e9) + (box?.height ?? 0)).toBeLessThanOrEqual(700);
    // The end of the page is not below it.
    const [last, step] = await page.evaluate(() => [document.querySelector('.part')?.lastElementChild?.getBoundingClientRect().bottom ?? 1e9, document.querySelector('.call')?.getBoundingClientRect().top ?? 0]);
    expect(last).toBeLessThanOrEqual(step ?? 0);
  });
});

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
