// Where the keyboard focus is after a small form opens, closes, works or fails.

import { describe, expect, it } from 'vitest';

import { daemon, fill, page, url } from './stage';

/** Tag and name of what has the focus, and of a field the selected text. */
const focused = (): Promise<string> =>
  page.evaluate(() => {
    const at = document.activeElement as HTMLElement;
    const selected = at instanceof HTMLInputElement ? ` “${at.value.slice(at.selectionStart ?? 0, at.selectionEnd ?? 0)}”` : '';
    return `${at.tagName} ${at.getAttribute('aria-label') ?? at.textContent?.trim().replace(/\s+/g, ' ').slice(0, 40) ?? ''}${selected}`;
  });

async function press(name: string | RegExp): Promise<void> {
  await page.getByRole('button', { name, exact: true }).first().focus();
  await page.keyboard.press('Enter');
}

describe('the focus', () => {
  it('goes to the new name of a part and back to its button', async () => {
    await page.goto(`${url}/#/setup`);
    await page.getByRole('button', { name: 'Rename …' }).first().waitFor();
    await press('Rename …');
    await expect.poll(focused).toBe('INPUT New name of the part “model 15°”');
    await press('Cancel');
    await expect.poll(focused).toBe('BUTTON Rename …');
    await page.keyboard.press('Enter');
    await page.keyboard.type('model 16°');
    await page.keyboard.press('Enter');
    await page.getByText('model 16°').first().waitFor();
    await expect.poll(focused).toBe('BUTTON Rename …');
  });

  it('goes into a new recipe, and back when it is cancelled', async () => {
    fill();
    await page.goto(`${url}/#/setup`);
    await page.getByRole('button', { name: 'New recipe' }).waitFor();
    await press('New recipe');
    await expect.poll(focused).toMatch(/^INPUT/);
    await press('Cancel');
    await expect.poll(focused).toBe('BUTTON New recipe');
    await press('Change PX-1204');
    await expect.poll(focused).toMatch(/^(INPUT|SELECT|TEXTAREA)/);
    await press('Cancel');
    await expect.poll(focused).toBe('BUTTON Change PX-1204');
    // A button that shows more keeps it, also after what it showed has closed.
    await press('New part');
    await page.getByTestId('sample-form').getByLabel('Name', { exact: true }).fill('B-17');
    expect(await focused()).toMatch(/^INPUT/);
    await press('Add part');
    await expect.poll(focused).toBe('BUTTON New part');
  });

  it('is on the choice of the other part, and on its button again', async () => {
    fill();
    await page.goto(`${url}/#/result/2`);
    await page.getByRole('button', { name: 'Other part …' }).waitFor();
    await press('Other part …');
    await expect.poll(focused).toMatch(/^SELECT/);
    await press('Cancel');
    await expect.poll(focused).toBe('BUTTON Other part …');
  });

  it('stays with the lease while it is taken and given back', async () => {
    await page.goto(`${url}/#/rig`);
    await page.getByRole('button', { name: 'Hold the rig' }).waitFor();
    await press('Hold the rig');
    await expect.poll(focused).toBe('BUTTON Give back');
    await page.keyboard.press('Enter');
    await expect.poll(focused).toBe('BUTTON Hold the rig');
    // Where a press confirms, the first one that has the focus is the harmless one.
    daemon.holder = { who: 'bert', name: 'night run', until: null };
    daemon.event('order', {});
    await page.getByRole('button', { name: 'Take over …' }).waitFor();
    await press('Take over …');
    await expect.poll(focused).toBe('BUTTON Leave it');
  });

  it('is on the button of the fit again once the fit has ended, unless a person went elsewhere', async () => {
    daemon.fitMs = 400;
    fill();
    await page.goto(`${url}/#/result/2`);
    await page.getByRole('button', { name: 'Fit again' }).waitFor();
    await press('Fit again');
    await page.getByRole('button', { name: 'Fitting …' }).waitFor();
    await page.getByRole('button', { name: 'Fit again' }).waitFor();
    await expect.poll(focused).toBe('BUTTON Fit again');
    await page.keyboard.press('Enter');
    await page.getByRole('button', { name: 'Fitting …' }).waitFor();
    await page.getByRole('link', { name: 'Verdict' }).focus();
    await page.getByRole('button', { name: 'Fit again' }).waitFor();
    expect(await focused()).toBe('A Verdict');
  });
});
