// A running scan: its steps, frames, commands and curves.

import { describe, expect, it } from 'vitest';

import { chooseSample, daemon, page, posts, text, url } from './stage';

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

describe('a paused scan', () => {
  it('shows the time left, and its reason once: in the alarm until that is seen, then beside Resume', async () => {
    daemon.frameMs = 100;
    await page.goto(url);
    await chooseSample();
    await page.getByText('full', { exact: true }).click();
    await page.getByRole('button', { name: 'Start scan' }).click();
    for (let i = 0; i < 3; i++) await page.getByRole('button', { name: 'Continue' }).click();
    await page.getByText(/^sample, [1-9]\d* of/).waitFor();
    await page.getByRole('button', { name: 'Pause' }).click();
    await page.getByRole('button', { name: 'Resume' }).waitFor();
    expect(await text('.figures')).toMatch(/^\d+ % \d.* left$/);
    const reason = 'the camera failed: exit status 3; fix it, then resume';
    daemon.event('alarm', { code: 'camera-failed', message: reason, scan_id: 1 });
    daemon.event('scan', { scan_id: 1, sample_id: 1, state: 'paused', reason, operator: null, progress: daemon.scans[0]?.body['progress'] });
    const words = page.getByText('The camera failed: exit status 3; fix it, then resume.');
    await page.getByRole('alert').filter({ has: words }).waitFor();
    expect(await words.count()).toBe(1);
    await page.getByRole('button', { name: 'Seen' }).click();
    await page.locator('section[aria-labelledby=scan-title]').filter({ has: words }).waitFor();
    expect(await words.count()).toBe(1);
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
