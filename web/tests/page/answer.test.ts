// The answer: the value so far, the fit, and why there is none.

import { describe, expect, it } from 'vitest';

import { chooseSample, daemon, page, posts, text, url } from './stage';

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
