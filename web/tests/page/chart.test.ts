// The page with a mock daemon: the control chart of results.

import { beforeEach, describe, expect, it } from 'vitest';

import { axeViolations, daemon, page, text, url } from './stage';

const plot = () => page.getByTestId('control-plot');
const rows = () => page.getByTestId('chart-values').locator('tbody tr');

/** A fitted and judged scan per value, one minute apart. */
function series(values: readonly number[], columns: Record<string, unknown> = {}): void {
  values.forEach((theta_r_deg, i) => {
    const scan = daemon.addScan(1, 'paper');
    daemon.addFit(scan);
    const body = daemon.scans.find((s) => s.body.id === scan)?.body;
    if (body) body['result'] = { theta_r_deg, theta_r_deg_std: 0.02, theta_r_deg_expanded: 0.04, alpha_u: 0.12, alpha_u_std: 0.001, verdict: 'pass', verdict_id: 1, specification: 'drawing 4711', lot: 'L7', created_at: new Date(2026, 2, 1, 8, i).toISOString(), ...columns };
  });
}

beforeEach(() => {
  const limits = { theta_r_deg: { lower: 9.7, upper: 10.4 }, alpha_u: { upper: 0.14 } };
  daemon.specifications.add({ name: 'drawing 4711', limits });
  daemon.verdicts.push({ id: 1, scan_id: 1, state: 'completed', verdict: 'pass', specification: 'drawing 4711', decision_rule: 'JCGM 106', request: {}, items: [{ quantity: 'theta_r_deg', value: 10, expanded: 0.04, lower: 9.7, upper: 10.4, acceptance_lower: 9.75, acceptance_upper: 10.35, conformance_probability: 1, verdict: 'pass', reason: '' }] });
});

describe('the control chart', () => {
  it('is opened from the records with their filters: mean ± 3 s, limits and guard bands of the specification', async () => {
    series([10, 10.02, 9.98, 10, 10.02, 9.98]);
    series([12], { lot: 'L8' });
    await page.goto(`${url}/#/records?lot=L7`);
    await page.getByRole('link', { name: 'Control chart' }).click();
    await expect.poll(() => text('#chart-title')).toBe('Control chart: θr of lot L7');
    await expect.poll(() => rows().count()).toBe(6);
    expect(await text('[data-testid=chart-mean]')).toBe('10.000°');
    // Moving ranges 0.02, 0.04, 0.02, 0.02, 0.04: their mean is 0.028, s = 0.0248°.
    expect(await text('[data-testid=chart-s]')).toBe('0.025°');
    expect(await text('[data-testid=chart-limits]')).toBe('9.926° to 10.074°');
    expect(await text('[data-testid=chart-tolerance]')).toBe('9.7° to 10.4°');
    await expect.poll(() => text('[data-testid=chart-accepted]')).toBe('9.750° to 10.350°');
    await expect.poll(() => plot().getByTestId('tolerance-limit').count()).toBe(2);
    expect(await page.getByText('Limits beyond the drawn range').count()).toBe(0);
    expect(await text('[data-testid=chart-signals]')).toContain('no signal');
    expect((await rows().first().innerText()).replace(/\s+/g, ' ')).toBe('6 traced polymer 9.980 ± 0.040 0.040 pass 2026-03-01 08:05');
    await page.reload();
    await expect.poll(() => rows().count()).toBe(6);
    await page.getByRole('link', { name: 'Change the scans' }).click();
    await page.getByTestId('records').waitFor();
    expect(new URL(page.url()).hash).toBe('#/records?lot=L7');
  });

  it('marks values beyond the control limits and eight in a row on one side, and says so', async () => {
    series([10, 10.02, 9.98, 10.02, 9.98, 10.02, 9.98, 10.6, ...new Array<number>(9).fill(9.99)]);
    await page.goto(`${url}/#/chart?specification=drawing+4711`);
    await expect.poll(() => text('[data-testid=chart-signals]')).toMatch(/2 signals .* Scans 9 to 17: 9 values in a row below the mean\. Scan 8: 10\.\d+° is above the control limit 10\.\d+° \(mean \+ 3 s\)\./);
    expect(await plot().locator('g.beyond').evaluateAll((marks) => marks.map((m) => m.getAttribute('data-scan')))).toEqual(['8']);
    await expect.poll(() => plot().locator('g.run').count()).toBe(9);
    expect((await rows().nth(9).innerText()).replace(/\s+/g, ' ')).toContain('beyond 3 s');
  });

  it('shows other parameters of the specification, and follows new results', async () => {
    series([10, 10.1]);
    await page.goto(`${url}/#/chart?sample=1`);
    await expect.poll(() => text('#chart-title')).toBe('Control chart: θr of part traced polymer');
    await page.getByRole('combobox', { name: 'Parameter' }).selectOption({ label: 'roughness along the ridges' });
    await expect.poll(() => text('[data-testid=chart-tolerance]')).toBe('at most 0.14');
    expect(new URL(page.url()).hash).toBe('#/chart/alpha_u?sample=1');
    // No verdict on it: 1.96 u of the median u of 0.001.
    expect(await text('[data-testid=chart-accepted]')).toMatch(/^at most 0\.1380/);
    series([10.05]);
    await expect.poll(() => rows().count()).toBe(3);
    await page.getByRole('combobox', { name: 'Limits of' }).selectOption({ label: 'no specification' });
    await expect.poll(() => page.getByTestId('chart-tolerance').count()).toBe(0);
  });

  it('uses the limits that were typed for a verdict, where no specification has the name', async () => {
    daemon.specifications.stored.length = 0;
    Object.assign(daemon.verdicts[0] ?? {}, { request: { specification: { name: 'drawing 4711', limits: { theta_r_deg: { lower: 9.7, upper: 10.4 } } } } });
    series([10, 10.1]);
    await page.goto(`${url}/#/chart?specification=drawing+4711`);
    await expect.poll(() => text('[data-testid=chart-tolerance]')).toBe('9.7° to 10.4°');
  });

  it('says that limits are too far away to be drawn', async () => {
    daemon.specifications.stored[0]?.versions.push({ content: { name: 'drawing 4711', limits: { theta_r_deg: { lower: 9.7, upper: 90 } } }, saved_at: new Date().toISOString() });
    series([10, 10.1]);
    await page.goto(`${url}/#/chart`);
    await page.getByText('Limits beyond the drawn range').waitFor();
    await expect.poll(() => plot().getByTestId('tolerance-limit').count()).toBe(1);
    expect(await text('[data-testid=chart-tolerance]')).toBe('9.7° to 90°');
  });

  it('says what is missing', async () => {
    await page.goto(`${url}/#/chart`);
    await page.getByText('No scan has a result yet.').waitFor();
    series([10]);
    await page.goto(`${url}/#/chart?lot=L9`);
    await page.getByText('No scan matches these filters.').waitFor();
    await page.goto(`${url}/#/chart`);
    await page.getByText('One value has no control limits.').waitFor();
    await page.goto(`${url}/#/chart/crest_radius`);
    await page.getByText('No converged fit of these scans determines the radius of the crests').waitFor();
    daemon.refusals.set('GET /charts', { status: 503, body: { status: 503, code: 'store-unavailable', title: 'store', detail: 'the database cannot be read' } });
    await page.goto(`${url}/#/chart?lot=L7`);
    await page.getByRole('alert').getByText('The results cannot be read.').waitFor();
  });

  it('states what is due, also on the first view, with the way to the chart of the check standard', async () => {
    series([10, 10.02]);
    daemon.samples.push({ ...(daemon.samples[0] as object), id: 9, name: 'CS-1' } as never);
    const last_at = new Date(2026, 2, 1, 8, 0).toISOString();
    daemon.due.push({ what: 'check-standard', part: 'CS-1', last_at, due_at: new Date(2026, 2, 8, 8, 0).toISOString(), is_due: true });
    daemon.due.push({ what: 'references', part: null, last_at, due_at: '2099-01-01T00:00:00.000Z', is_due: false });
    await page.goto(`${url}/#/chart`);
    await expect.poll(() => text('[data-testid=due]')).toMatch(/^due Check standard CS-1 was last measured 2026-03-01 08:00: due since 2026-03-08 08:00\. Measure CS-1 and look at its control chart\. References were last taken 2026-03-01 08:00: due 20\d\d-\d\d-\d\d \d\d:\d\d\.$/);
    await page.goto(`${url}/#/measure`);
    const line = page.getByTestId('due').filter({ hasText: 'Check standard CS-1' });
    await line.getByRole('link', { name: 'Chart of CS-1' }).waitFor();
    // Only what is due.
    expect(await line.innerText()).not.toContain('References');
    expect(await axeViolations()).toEqual([]);
    await line.getByRole('link', { name: 'Chart of CS-1' }).click();
    await expect.poll(() => text('#chart-title')).toBe('Control chart: θr of part CS-1');
    daemon.due.length = 0;
    await page.goto(`${url}/#/measure`);
    await page.getByText('Last results').waitFor();
    await expect.poll(() => page.getByTestId('due').count()).toBe(0);
  });

  it('has no violation of axe-core and fits 320 pixels', async () => {
    series([10, 10.02, 9.98, 10.02, 9.98, 10.02, 9.98, 10.6, ...new Array<number>(9).fill(9.99)]);
    await page.setViewportSize({ width: 320, height: 640 });
    await page.goto(`${url}/#/chart?specification=drawing+4711`);
    await rows().first().waitFor();
    for (const theme of ['light', 'dark'] as const) {
      await page.evaluate((name) => (document.documentElement.dataset['theme'] = name), theme);
      expect(await axeViolations()).toEqual([]);
    }
    expect(await page.evaluate(() => document.documentElement.scrollWidth - innerWidth)).toBeLessThanOrEqual(0);
  });
});
