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

/** Sets columns of the result of a scan. */
function result(scan: number, columns: Record<string, unknown>): void {
  const body = daemon.scans.find((s) => s.body.id === scan)?.body;
  if (!body) throw new Error(`there is no scan ${scan}`);
  body['result'] = { ...(body['result'] as object | undefined), ...columns };
}
const resultReads = (): string[] => daemon.reads.filter((path) => path.startsWith('/results'));
const cells = async (): Promise<string[]> => (await rows().allInnerTexts()).map((row) => row.replace(/\s+/g, ' ').trim());

describe('the records', () => {
  it('are searched and filtered by the daemon, and the address reproduces the list', async () => {
    for (const sample of [1, 2, 1]) daemon.addFit(daemon.addScan(sample, 'paper'));
    const early = new Date(2026, 0, 5, 23, 30).toISOString();
    Object.assign(daemon.scans.find((s) => s.body.id === 2)?.body ?? {}, { state: 'aborted', created_at: early });
    await page.goto(`${url}/#/records`);
    await expect.poll(() => rows().count()).toBe(3);
    expect(await text('[data-testid=records-count]')).toBe('3 results');
    await page.getByLabel('Search').fill('polymer');
    await expect.poll(() => rows().count()).toBe(2);
    expect(await text('[data-testid=records-count]')).toBe('2 matching results');
    await page.getByLabel('Search').fill('');
    await page.getByRole('combobox', { name: 'State' }).selectOption('aborted');
    // The day ends at midnight of the page's time zone.
    await page.getByLabel('To', { exact: true }).fill('2026-01-05');
    await expect.poll(() => rows().count()).toBe(1);
    await page.reload();
    await expect.poll(() => rows().count()).toBe(1);
    await rows().getByRole('link', { name: 'model 15°' }).click();
    await expect.poll(() => text('#answer-title')).toBe('model 15°');
    await page.goBack();
    await expect.poll(() => rows().count()).toBe(1);
    await page.getByLabel('To', { exact: true }).fill('2026-01-04');
    await page.getByText('No scan matches these filters.').waitFor();
    await page.getByRole('button', { name: 'Clear', exact: true }).click();
    await expect.poll(() => rows().count()).toBe(3);
  });

  it('have the ridge angle of every scan, however old, page by page, without a list of fits', async () => {
    for (let n = 0; n < 130; n++) result(measured(1, n / 1000), { created_at: new Date(2026, 0, 1, 0, n).toISOString() });
    await page.goto(`${url}/#/records`);
    await expect.poll(() => rows().count()).toBe(100);
    const fitsBefore = daemon.reads.filter((path) => path.startsWith('/fits?')).length;
    await page.getByRole('button', { name: 'Show 30 more' }).click();
    await expect.poll(() => rows().count()).toBe(130);
    expect((await cells()).at(-1)).toContain('1 traced polymer 10.031 ± 0.085 completed 2026-01-01 00:00');
    expect(daemon.reads.filter((path) => path.startsWith('/fits?')).length).toBe(fitsBefore);
  });

  it('show verdict, lot, number, recipe and operator, and are ordered by a press on a head', async () => {
    for (const [moved, columns] of [
      [0.2, { lot: 'L7', external_id: 'A-1001', recipe: 'PX-1204', recipe_version: 3, operator_name: 'Anna', verdict: 'fail', specification: 'drawing 4711' }],
      [-0.1, { lot: 'L8', external_id: 'A-1002', recipe: 'PX-1204', recipe_version: 3, operator_name: 'Ben', verdict: 'pass', specification: 'drawing 4711' }],
      [0.1, {}],
    ] as const) result(measured(1, moved), columns);
    await page.goto(`${url}/#/records`);
    await expect.poll(() => rows().count()).toBe(3);
    expect((await cells())[2]).toContain('1 traced polymer 10.231 ± 0.085 fail A-1001 L7 PX-1204 v3 completed');
    await page.getByRole('columnheader', { name: /θ/ }).getByRole('button').click();
    await expect.poll(async () => (await cells()).map((row) => row.split(' ')[0])).toEqual(['1', '3', '2']);
    expect(await page.getByRole('columnheader', { name: /θ/ }).getAttribute('aria-sort')).toBe('descending');
    await page.reload();
    await expect.poll(async () => (await cells()).map((row) => row.split(' ')[0])).toEqual(['1', '3', '2']);
    await page.getByRole('combobox', { name: 'Verdict' }).selectOption({ label: 'does not pass' });
    await expect.poll(() => rows().count()).toBe(1);
    await page.getByRole('combobox', { name: 'Verdict' }).selectOption({ label: 'not judged' });
    await expect.poll(async () => (await cells())[0]).toContain('10.131 ± 0.085');
    await page.getByRole('combobox', { name: 'Verdict' }).selectOption({ label: 'any or none' });
    await page.getByLabel('Ridge angle at least, degrees').fill('10,1');
    await page.getByLabel('newest of each part').check();
    await expect.poll(() => rows().count()).toBe(1);
    const csv = new URL((await page.getByTestId('records-csv').getAttribute('href')) ?? '', url);
    expect(Object.fromEntries(csv.searchParams)).toEqual({ format: 'csv', theta_r_deg_min: '10.1', latest: 'true', sort: '-theta_r_deg' });
  });

  it('mute a verdict on other values, and show a value that was held as fixed, without a mark', async () => {
    result(measured(1, 0), { verdict: 'pass', verdict_matches: false, specification: 'drawing 7' });
    result(measured(1, 0), { verdict: 'pass', verdict_matches: true, specification: 'drawing 7', theta_r_deg: 12.000000000000002, theta_r_deg_std: null, theta_r_deg_expanded: null });
    await page.goto(`${url}/#/records`);
    await expect.poll(() => rows().count()).toBe(2);
    const [held = '', other = ''] = await cells();
    expect(held).toContain('traced polymer 12 (fixed) pass completed');
    expect(await rows().first().locator('.dot').count()).toBe(0);
    expect(await rows().first().locator('.chip.good', { hasText: 'pass' }).count()).toBe(1);
    expect(other).toContain('10.031 ± 0.085 pass of other values completed');
    const chip = rows().last().locator('.chip', { hasText: 'pass' });
    expect(await chip.getAttribute('class')).not.toContain('good');
    expect(await chip.getAttribute('title')).toBe('drawing 7. A later fit of this scan gave other values than this verdict judged. Judge the scan again.');
  });

  it('say at its field that a filter is not a number, and count no matches of it', async () => {
    measured(1, 0);
    await page.goto(`${url}/#/records?theta_min=abc`);
    await expect.poll(() => rows().count()).toBe(1);
    const field = page.getByLabel('Ridge angle at least, degrees');
    expect(await text(`#${(await field.getAttribute('aria-describedby')) ?? ''}`)).toBe('Give a number.');
    expect(await text('[data-testid=records-count]')).toBe('Not filtered by θr');
    await field.fill('9');
    await expect.poll(() => text('[data-testid=records-count]')).toBe('1 matching result');
    expect(await page.getByText('Give a number.').count()).toBe(0);
  });

  it('say that archived scans are left out, and list them on request', async () => {
    measured(1, 0);
    await page.goto(`${url}/#/result/1/record`);
    const warnings: string[] = [];
    page.on('console', (message) => warnings.push(message.text()));
    await page.getByRole('button', { name: 'Archive', exact: true }).click();
    await page.getByText('archived', { exact: true }).first().waitFor();
    await page.goto(`${url}/#/records`);
    await page.getByText('No scan to list. Archived scans are left out.').waitFor();
    await page.getByRole('button', { name: 'List archived scans too' }).click();
    await expect.poll(() => rows().count()).toBe(1);
    expect(warnings).toEqual([]);
  });

  it('follow scans that run, and their fits', async () => {
    daemon.frameMs = 60;
    daemon.fitsAtEnd = true;
    measured(1, 0);
    await page.goto(`${url}/#/records`);
    await expect.poll(() => rows().count()).toBe(1);
    const start = async (path: string, body: object): Promise<void> => void (await fetch(`${url}/api/v1${path}`, { method: 'POST', body: JSON.stringify(body) }));
    await start('/scans', { sample_id: 2, plan: { preset: 'paper' } });
    await expect.poll(async () => (await cells())[0]).toMatch(/^2 model 15° – (running|waiting for you)/);
    for (const action of ['cap-lens', 'place-white-reference', 'place-sample']) {
      await expect.poll(async () => (await cells())[0]).toContain('waiting for you');
      await start('/scans/2/continue', { action });
      await expect.poll(async () => (await cells())[0]).toContain('running');
    }
    await expect.poll(async () => (await cells())[0], { timeout: 20_000 }).toContain('2 model 15° 15.031 ± 0.085 completed');
    // Frames alone do not read the list again.
    expect(resultReads().length).toBeLessThan(15);
  });

  it('say why they cannot be read', async () => {
    daemon.refusals.set('GET /results', { status: 503, body: { status: 503, code: 'store-unavailable', title: 'store', detail: 'the database cannot be read' } });
    await page.goto(`${url}/#/records`);
    await page.getByRole('alert').getByText('The records cannot be read.').waitFor();
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
    // By the records angles and model are the same, so only counting and reference remain.
    expect((await row.innerText()).replace(/\s+/g, ' ')).toContain('0.0500° ± 0.0060° 8.27 differ');
    // The list is that of the command: gain and stray light are in it.
    expect(await page.getByTestId('differences').locator('tbody tr').evaluateAll((rows) => rows.map((r) => (r as HTMLElement).dataset['row']))).toEqual(['theta_r_deg', 'alpha_u', 'alpha_v', 'rho_d', 'scale', 'background', 'azimuth_offset_deg', 'tilt_offset_deg']);
    await expect.poll(() => page.getByTestId('compared-curves').locator('canvas').count()).toBe(10);
    expect(await text('[data-testid=compare]')).toContain('same error in both scans: 2');
    // With independent errors the same difference is not significant: U of each is 0.085°.
    await page.getByText('Lines of the budget of').click();
    await page.getByText('same rig, part and poses').first().waitFor();
    for (const line of ['angles', 'model']) await page.getByLabel(`${line}: same error in all scans`).uncheck();
    await expect.poll(async () => (await row.innerText()).replace(/\s+/g, ' ')).toContain('0.05° ± 0.12° 0.41 agree');
    expect(daemon.reads.at(-1)).toBe('/comparisons?scan_id=1&scan_id=2&shared=none');
    await page.getByRole('button', { name: 'As the records show' }).click();
    await expect.poll(() => row.innerText()).toContain('differ');
  });

  it('of which one has no fit say so, with the way to it', async () => {
    measured(1, 0);
    daemon.addScan(2, 'paper');
    await page.goto(`${url}/#/compare/1,2`);
    await page.getByText('A scan has no finished fit.').waitFor();
    expect(daemon.reads.filter((read) => read.startsWith('/comparisons')).length).toBe(1);
    await page.getByTestId('compare').getByRole('alert').getByRole('link', { name: 'Scan 2' }).click();
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
    // Counting and reference do not explain it.
    expect(await text('[data-testid=repeat-stated]')).toBe('0.0021°');
    await expect.poll(() => page.getByTestId('repeat-scans').locator('tbody tr').count()).toBe(3);
    expect(await text('[data-testid=repeat-verdict]')).toBe('scatter too large');
    expect(await text('[data-testid=repeat-probability]')).toBe('< 0.01 %');
    await page.getByText('Lines of the budget that are the same').click();
    for (const line of ['angles', 'model']) await page.getByLabel(`${line}: same error in all scans`).uncheck();
    // The answer for the first choice is already consistent; only the uncertainty differs.
    await expect.poll(() => text('[data-testid=repeat-stated]')).toBe('0.043°');
    expect(await text('[data-testid=repeat-verdict]')).toBe('consistent');
    // One part has no gauge R&R, and the card says what it needs.
    await page.getByTestId('gauge').getByText('gauge R&R needs several parts').waitFor();
    // One question for each choice of lines, and the first one.
    expect(daemon.reads.filter((read) => read.startsWith('/repeatability')).length).toBe(3);
  });

  it('of several parts has the components of the scatter, over operators or days', async () => {
    for (const sample of [1, 1, 2, 2]) measured(sample, 0.01 * sample);
    await page.goto(`${url}/#/repeat/1,2,3,4`);
    const gauge = page.getByTestId('gauge');
    await gauge.getByText('Reproducibility (operators)').waitFor();
    expect(await text('[data-testid=gauge-percent]')).toContain('20 %');
    expect(await text('[data-testid=gauge-categories]')).toContain('6 3 to 18 274');
    await gauge.getByText('2 operators are too few for an interval').waitFor();
    await gauge.getByLabel('Reproducibility over').selectOption('day');
    await gauge.getByText('Reproducibility (days)').waitFor();
    expect(daemon.reads.some((read) => read.endsWith('scan_id=4&by=day'))).toBe(true);
  });

  it('needs two results of a part', async () => {
    measured(1, 0);
    measured(2, 0);
    await page.goto(`${url}/#/repeat/1,2`);
    await page.getByText('No part has two results: traced polymer, model 15°.').waitFor();
    // One result is its own mean.
    for (const row of await page.getByTestId('repeat-scans').locator('tbody tr').all()) expect(await row.locator('td.number').nth(1).innerText()).toBe('–');
  });
});

describe('the record of a scan', () => {
  it('has tags and a note, and is archived with an undo', async () => {
    measured(1, 0);
    measured(2, 0);
    await page.goto(`${url}/#/result/1/record`);
    const card = page.getByTestId('scan-record');
    await card.getByLabel('Tags, separated by commas').fill('study 1, night, study 1');
    await card.getByRole('textbox', { name: 'Note' }).fill('scratch at the edge');
    await card.getByRole('button', { name: 'Save' }).click();
    await card.getByText('Saved.').waitFor();
    expect(daemon.requests.at(-1)).toEqual({ method: 'PATCH', path: '/scans/1', body: { tags: ['study 1', 'night'], note: 'scratch at the edge' } });
    await expect.poll(() => card.getByLabel('Tags, separated by commas').inputValue()).toBe('study 1, night');
    await card.getByRole('button', { name: 'Archive' }).click();
    await card.getByTestId('archived').waitFor();
    await card.getByText('Changes: 2').waitFor();
    // Lists leave it out; its address still shows it, also after a reload.
    await page.goto(`${url}/#/measure`);
    await page.getByText('Last results').first().waitFor();
    expect(await page.locator('main a[href^="#/result/1"]').count()).toBe(0);
    await page.goto(`${url}/#/result/1/record`);
    await page.reload();
    await card.getByTestId('archived').waitFor();
    await card.getByRole('button', { name: 'Restore' }).click();
    await card.getByText('Restored').waitFor();
    await card.getByRole('button', { name: 'Undo' }).click();
    await card.getByTestId('archived').waitFor();
    expect(daemon.requests.at(-1)).toEqual({ method: 'PATCH', path: '/scans/1', body: { archived: true } });
  });

  it('that is refused says why and keeps what was written', async () => {
    measured(1, 0);
    await page.goto(`${url}/#/result/1/record`);
    const card = page.getByTestId('scan-record');
    daemon.refusals.set('PATCH /scans/1', { status: 422, body: { status: 422, code: 'invalid-value', title: 'a value is not valid', detail: 'tags: expected tags of 1 to 40 characters, got 50', errors: [{ field: 'tags', message: 'expected tags of 1 to 40 characters, got 50' }] } });
    await card.getByLabel('Tags, separated by commas').fill('x'.repeat(50));
    await card.getByRole('button', { name: 'Save' }).click();
    await card.getByText('1 to 40 characters').waitFor();
    expect(await card.getByLabel('Tags, separated by commas').inputValue()).toBe('x'.repeat(50));
  });
});
