// The page with a mock daemon: finding scans, comparing two, and the repeatability of several.

import { describe, expect, it } from 'vitest';

import { daemon, page, text, url } from './stage';

const rows = () => page.getByTestId('scans').locator('tbody tr');

/** A fit of a new scan, moved by this angle. */
function measured(sample: number, moved: number): number {
  const scan = daemon.addScan(sample, 'paper');
  daemon.addFit(scan);
  const angle = (daemon.fits[0]?.['parameters'] as Record<string, { value: number }>)['theta_r_deg'];
  if (angle) angle.value += moved;
  return scan;
}

describe('the records', () => {
  it('are searched and filtered, and keep the filters in the address', async () => {
    for (const sample of [1, 2, 1]) daemon.addFit(daemon.addScan(sample, 'paper'));
    Object.assign(daemon.scans.find((s) => s.body.id === 2)?.body ?? {}, { state: 'aborted', reason: 'aborted by anna', started_at: new Date(2026, 0, 5, 9).toISOString() });
    await page.goto(`${url}/#/records`);
    await expect.poll(() => rows().count()).toBe(3);
    await page.getByLabel('Search').fill('polymer');
    await expect.poll(() => rows().count()).toBe(2);
    expect(await text('[data-testid=records-count]')).toBe('2 of 3 scans');
    await page.getByLabel('Search').fill('');
    await page.getByRole('combobox', { name: 'State' }).selectOption('aborted');
    await page.getByLabel('To').fill('2026-01-05');
    await expect.poll(() => rows().count()).toBe(1);
    await page.reload();
    await expect.poll(() => rows().count()).toBe(1);
    await rows().getByRole('link', { name: 'model 15°' }).click();
    await expect.poll(() => text('#answer-title')).toBe('model 15°');
    await page.goBack();
    await expect.poll(() => rows().count()).toBe(1);
    await page.getByLabel('To').fill('2026-01-04');
    await page.getByText('No scan matches these filters.').waitFor();
    await page.getByRole('button', { name: 'Clear', exact: true }).click();
    await expect.poll(() => rows().count()).toBe(3);
  });
});

describe('two scans', () => {
  it('are compared: differences, E_n, and curves over each other', async () => {
    measured(1, 0);
    measured(1, 0.05);
    await page.goto(`${url}/#/records`);
    for (const id of [1, 2]) await page.getByLabel(`Choose scan ${id}`).check();
    await page.getByRole('link', { name: 'Compare the two' }).click();
    const row = page.getByTestId('differences').locator('[data-row=theta_r_deg]');
    await row.waitFor();
    // U of each is 0.085°, so U of the difference 0.120°.
    expect((await row.innerText()).replace(/\s+/g, ' ')).toContain('0.05° ± 0.12° 0.41 agree');
    await expect.poll(() => page.getByTestId('compared-curves').locator('canvas').count()).toBe(10);
    expect(await text('[data-testid=compare]')).toContain('do not cancel here');
    // With everything but counting shared the same difference is significant.
    await page.getByText('Shared lines of the budget').click();
    for (const line of ['reference', 'angles', 'model']) await page.getByLabel(`${line}: same error in all scans`).check();
    await expect.poll(async () => (await row.innerText()).replace(/\s+/g, ' ')).toContain('differ');
    await page.reload();
    await row.waitFor();
    expect(await row.innerText()).toContain('agree');
  });

  it('of which one has no fit say so, with the way to it', async () => {
    measured(1, 0);
    daemon.addScan(2, 'paper');
    await page.goto(`${url}/#/compare/1,2`);
    await page.getByText('Scan 2 has no finished fit.').waitFor();
    await page.getByTestId('compare').getByRole('alert').getByRole('link', { name: 'scan 2' }).click();
    await page.getByRole('button', { name: 'Fit', exact: true }).waitFor();
  });
});

describe('the repeatability of a part', () => {
  it('is its scatter beside the stated uncertainty, with a chi-square', async () => {
    for (const moved of [-0.02, 0, 0.02]) measured(1, moved);
    await page.goto(`${url}/#/records`);
    for (const id of [1, 2, 3]) await page.getByLabel(`Choose scan ${id}`).check();
    await page.getByRole('link', { name: 'Repeatability of 3' }).click();
    await expect.poll(() => text('[data-testid=repeat-scatter]')).toBe('0.020°');
    expect(await text('[data-testid=repeat-stated]')).toBe('0.043°');
    expect(await page.getByTestId('repeat-scans').locator('tbody tr').count()).toBe(3);
    expect(await text('[data-testid=repeat-verdict]')).toBe('consistent');
    // Counting and reference do not explain it.
    await page.getByText('Lines of the budget that are the same').click();
    for (const line of ['angles', 'model']) await page.getByLabel(`${line}: same error in all scans`).check();
    await expect.poll(() => text('[data-testid=repeat-verdict]')).toBe('scatter too large');
    expect(await text('[data-testid=repeat-probability]')).toBe('< 0.01 %');
  });

  it('is not that of different samples', async () => {
    measured(1, 0);
    measured(2, 0);
    await page.goto(`${url}/#/repeat/1,2`);
    await page.getByText('These scans are of different samples: traced polymer, model 15°.').waitFor();
  });
});
