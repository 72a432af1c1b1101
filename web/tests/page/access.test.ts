// Login, logout, and the lease of the rig.

import { expect, it } from 'vitest';

import { chooseSample, daemon, fill, page, posts, text, url, VIEWS } from './stage';

async function loggedIn(token: string): Promise<void> {
  await page.locator('input[type=password]').fill(token);
  await page.getByRole('button', { name: 'Log in' }).click();
}

it('asks for a token, refuses a wrong one, and shows who is logged in', async () => {
  daemon.tokens.set('ridged_anna', { who: 'anna', role: 'operator' });
  daemon.addScan(1, 'paper');
  await page.goto(`${url}/#/records`);
  await page.getByRole('heading', { name: 'Log in to ridged' }).waitFor();
  // Nothing is shown or asked before, and the stop works.
  expect(await page.locator('#records-title').count()).toBe(0);
  expect(daemon.reads.filter((path) => path.startsWith('/scans'))).toEqual([]);
  await page.keyboard.press('Escape');
  await expect.poll(posts).toContain('/rig/stop');
  await loggedIn('ridged_wrong');
  await page.getByText('The token is not valid, or was revoked.').waitFor();
  expect(await page.locator('input[type=password]').inputValue()).toBe('');
  await loggedIn('ridged_anna');
  await page.locator('#records-title').waitFor();
  await expect.poll(() => text('header .user')).toContain('anna operator');
  await page.getByRole('button', { name: 'Log out' }).click();
  await page.getByRole('heading', { name: 'Log in to ridged' }).waitFor();
  expect(page.url()).not.toContain('ridged_');
});

it('shows a command as one unbroken line of code, also in a refusal', async () => {
  daemon.tokens.set('ridged_anna', { who: 'anna', role: 'operator' });
  daemon.refusals.set('POST /session', { status: 401, body: { status: 401, code: 'wrong-token', title: 'the token is not valid', detail: 'the token is not valid, or was revoked; `ridged token list` on the daemon’s machine shows the valid ones' } });
  await page.goto(url);
  await page.getByRole('heading', { name: 'Log in to ridged' }).waitFor();
  await loggedIn('ridged_wrong');
  await page.getByRole('alert').locator('code').getByText('ridged token list').waitFor();
  expect(await text('main')).not.toContain('`');
  const command = page.locator('form > .note code');
  expect(await command.evaluate((code) => { const range = document.createRange(); range.selectNodeContents(code); return new Set([...range.getClientRects()].map((r) => r.top)).size; })).toBe(1);
});

it('says that the session has ended after its token was revoked, and not that the daemon cannot be reached', async () => {
  daemon.tokens.set('ridged_anna', { who: 'anna', role: 'operator' });
  await page.goto(url);
  await page.getByRole('heading', { name: 'Log in to ridged' }).waitFor();
  // A first visit has no session that could end, and asks for nothing but who uses the page.
  expect(await page.getByText('Your session has ended').count()).toBe(0);
  expect(daemon.reads).toEqual(['/session']);
  await loggedIn('ridged_anna');
  await page.getByText('at rest').waitFor();
  daemon.revoke();
  await page.getByText('Your session has ended, or the token was revoked.').waitFor();
  await page.waitForTimeout(1000);
  expect(await page.getByText('The daemon cannot be reached.').count()).toBe(0);
  await loggedIn('ridged_wrong');
  await page.getByText('The token is not valid, or was revoked.').waitFor();
  // The next try needs no click.
  await expect.poll(() => page.locator('input[type=password]').evaluate((field) => field === document.activeElement)).toBe(true);
  daemon.tokens.set('ridged_anna', { who: 'anna', role: 'operator' });
  await loggedIn('ridged_anna');
  await page.getByText('at rest').waitFor();
  await page.getByRole('button', { name: 'Log out' }).click();
  await page.getByRole('heading', { name: 'Log in to ridged' }).waitFor();
  expect(await page.getByText('Your session has ended').count()).toBe(0);
});

it('shows who holds the rig and takes it over after a confirmation only', async () => {
  daemon.holder = { who: 'bert', name: 'night run', until: new Date(Date.now() + 60_000).toISOString() };
  await page.goto(`${url}/#/rig`);
  await page.getByText('holds the rig: night run').waitFor();
  const home = page.getByRole('button', { name: 'Home' }).first();
  await expect.poll(() => home.isDisabled()).toBe(true);
  await page.getByRole('button', { name: 'Take over …' }).click();
  expect(posts()).not.toContain('/lease');
  await page.getByRole('button', { name: 'Take over from bert' }).click();
  await page.getByText('This page holds the rig.').waitFor();
  expect(daemon.requests.find((r) => r.path === '/lease')?.body).toEqual({ name: 'page of local', take_over: true, seconds: 150 });
  await expect.poll(() => home.isDisabled()).toBe(false);
  await page.getByRole('button', { name: 'Give back' }).click();
  await page.getByRole('button', { name: 'Hold the rig' }).waitFor();
});

it('keeps its lease over a reload, and says who took the rig over', async () => {
  await page.goto(`${url}/#/rig`);
  const hold = page.getByRole('button', { name: 'Hold the rig' });
  expect(await hold.getAttribute('title')).toBe('Only this page gives orders until it gives the rig back, or for 2 min 30 s after it was closed');
  await hold.click();
  await page.getByText('This page holds the rig.').waitFor();
  await page.reload();
  await page.getByText('This page holds the rig.').waitFor();
  daemon.takeOver('bob', 'night run');
  await page.getByRole('alert').getByText('bob took the rig over from you.').waitFor();
  await page.getByText('holds the rig: night run').waitFor();
  // What a person gives back was not taken.
  await page.getByRole('button', { name: 'Take over …' }).click();
  await page.getByRole('button', { name: 'Take over from bob' }).click();
  await page.getByRole('button', { name: 'Close' }).click();
  await page.getByRole('button', { name: 'Give back' }).click();
  await hold.waitFor();
  expect(await page.getByText('took the rig over').count()).toBe(0);
});

it('starts no scan while another caller holds the rig, and says who does', async () => {
  const until = new Date(Date.now() + 60_000);
  const held = `bert holds the rig: night run, until ${String(until.getHours()).padStart(2, '0')}:${String(until.getMinutes()).padStart(2, '0')} or longer.`;
  daemon.holder = { who: 'bert', name: 'night run', until: until.toISOString() };
  await page.goto(url);
  await chooseSample();
  await expect.poll(() => text('[data-testid=held]')).toBe(held);
  await page.getByText('53 frames').waitFor();
  const start = page.getByRole('button', { name: 'Start scan' });
  expect(await start.isDisabled()).toBe(true);
  expect(await page.getByRole('button', { name: 'Calibrate only' }).isDisabled()).toBe(true);
  expect(await text('header .status')).toContain('bert holds the rig');
  daemon.holder = null;
  // The page asks every three seconds.
  await expect.poll(() => start.isDisabled(), { timeout: 10_000 }).toBe(false);
  expect(await page.getByTestId('held').count()).toBe(0);
  // The page may not yet know it.
  daemon.refusals.set('POST /scans', { status: 409, body: { code: 'lease-held', detail: 'bert holds the rig (`take_over` of POST /api/v1/lease)', holder: { who: 'bert', name: 'night run', until: until.toISOString() } } });
  await start.click();
  await page.getByRole('alert').getByText(`${held} Wait, or take the rig over in the view Rig.`).waitFor();
});

it('offers to a viewer only what a viewer may do', async () => {
  daemon.tokens.set('ridged_vera', { who: 'vera', role: 'viewer' });
  fill();
  daemon.due.push({ what: 'check-standard', part: 'CS-1', last_at: null, due_at: null, is_due: true });
  const refused: string[] = [];
  await page.goto(url);
  await loggedIn('ridged_vera');
  await page.getByText('Your role is viewer. The role operator measures parts.').waitFor();
  const deeds = /^(Start scan|Add to queue|Calibrate only|Start the queue|Rename …|New part|New recipe|New specification|Change|Archive|Other part …|Fit|Fit again|Judge|Map every pixel|Measure contrast|Save|Import|Trace|Home|Move|Take a look|Hold the rig)$/;
  for (const [view, words] of VIEWS) {
    await page.goto(`${url}/#/${view}`);
    await page.locator('main').getByText(view === 'lab' ? 'Virtual ellipsometer' : words, { exact: false }).first().waitFor();
    for (const button of await page.locator('main button:visible:enabled').all()) {
      const name = (await button.innerText()).trim();
      if (deeds.test(name)) refused.push(`${view}: ${name}`);
    }
  }
  expect(refused).toEqual([]);
  // Neither did the page ask for what the role is refused, such as an estimate.
  expect(daemon.requests.map((r) => `${r.method} ${r.path}`)).toEqual(['POST /session']);
});

it('offers no lease to a viewer', async () => {
  daemon.tokens.set('ridged_vera', { who: 'vera', role: 'viewer' });
  daemon.holder = { who: 'bert', name: 'night run', until: null };
  await page.goto(`${url}/#/rig`);
  await loggedIn('ridged_vera');
  await page.getByText('holds the rig: night run, until its end.').waitFor();
  expect(await page.getByRole('button', { name: 'Take over …' }).count()).toBe(0);
});
