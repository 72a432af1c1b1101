// The queue on the page with a mock daemon: orders are added from the form of the next part, moved and removed, and the queue is started.

import { describe, expect, it } from 'vitest';

import { chooseSample, daemon, page, posts, url } from './stage';

describe('the queue', () => {
  it('takes parts in sequence and starts', async () => {
    daemon.recipes.add({ name: 'PX-1204', plan: { preset: 'paper' } });
    await page.goto(url);
    const form = page.getByTestId('next-part');
    const card = page.getByTestId('queue');
    await card.getByText('No part waits. Add to queue puts the next part here.').waitFor();
    await form.getByLabel('Lot').fill('4');
    for (const [sample, part, number] of [['traced polymer (n 1.54)', 'traced polymer', 'A-1'], ['model 15° (n 1.54)', 'model 15°', 'A-2']] as const) {
      await chooseSample(sample);
      await form.getByLabel('External number').fill(number);
      await form.getByRole('button', { name: 'Add to queue' }).click();
      await card.getByText(part, { exact: true }).waitFor();
      // The next part is chosen by a person; it is often of the same lot.
      await form.getByText('Choose the part first.').waitFor();
      expect(await form.getByLabel('External number').inputValue()).toBe('');
    }
    // The only recipe is chosen without a click.
    expect(daemon.orders.map((o) => [o['sample_id'], (o['recipe'] as { name: string }).name, o['lot'], o['external_id']])).toEqual([[1, 'PX-1204', '4', 'A-1'], [2, 'PX-1204', '4', 'A-2']]);
    await card.getByRole('button', { name: 'Move model 15° up' }).click();
    await expect.poll(() => card.locator('li b').allTextContents()).toEqual(['model 15°', 'traced polymer']);
    await card.getByRole('button', { name: 'Remove traced polymer' }).click();
    await expect.poll(() => card.locator('li b').allTextContents()).toEqual(['model 15°']);
    await card.getByRole('button', { name: 'Start the queue' }).click();
    await card.getByRole('button', { name: 'Stop after this one' }).waitFor();
    expect(posts().at(-1)).toBe('/queue/start');
  });

  it('shows a failed order with its reason, and lets it wait again or removes it', async () => {
    const order = { lot: '4', external_id: null, scan_id: null, recipe: { id: 1, name: 'PX-1204' }, specification: null };
    daemon.orders.push({ ...order, id: 1, part: 'A-1', sample_id: 1, state: 'failed', reason: 'the part has no material', scan_id: 3 }, { ...order, id: 2, part: 'A-2', sample_id: 2, state: 'failed', reason: 'aborted' });
    await page.goto(url);
    const failed = page.getByTestId('failed-orders');
    await failed.getByText('The part has no material.').waitFor();
    await page.getByRole('heading', { name: '2 failed orders' }).waitFor();
    expect(await failed.getByRole('link', { name: 'Scan 3' }).getAttribute('href')).toBe('#/result/3');
    await failed.getByRole('button', { name: 'Retry A-1' }).click();
    await page.getByTestId('queue').getByRole('button', { name: 'Move A-1 up' }).waitFor();
    expect(posts()).toEqual(['/queue/orders/1/retry']);
    await failed.getByRole('button', { name: 'Remove A-2' }).click();
    await failed.waitFor({ state: 'detached' });
    expect(daemon.orders.map((o) => o['state'])).toEqual(['waiting', 'removed']);
  });

  it('keeps a note with its order, and a scan that is started has it', async () => {
    daemon.recipes.add({ name: 'PX-1204', plan: { preset: 'paper' } });
    await page.goto(url);
    const note = page.getByTestId('next-part').getByLabel('Note');
    await chooseSample();
    await note.fill(' after cleaning ');
    await page.getByRole('button', { name: 'Add to queue' }).click();
    await expect.poll(() => daemon.orders.map((o) => o['note'])).toEqual(['after cleaning']);
    // It is of one part only.
    await expect.poll(() => note.inputValue()).toBe('');
    await chooseSample();
    await note.fill('scratch at the edge');
    await page.getByRole('button', { name: 'Start scan' }).click();
    await expect.poll(() => daemon.requests.filter((r) => r.method === 'PATCH').map((r) => [r.path, r.body])).toEqual([['/scans/1', { note: 'scratch at the edge' }]]);
  });

  it('takes the next part while a scan runs', async () => {
    daemon.recipes.add({ name: 'PX-1204', plan: { preset: 'paper' } });
    await page.goto(url);
    await chooseSample();
    await page.getByRole('button', { name: 'Start scan' }).click();
    await page.getByRole('heading', { name: 'Cap the lens' }).waitFor();
    await page.getByText('Add the next part').click();
    // The part on the table is not the next one.
    expect(await page.getByRole('combobox', { name: /^Part/ }).locator('option:checked').innerText()).toBe('Which part is next?');
    await chooseSample('model 15° (n 1.54)');
    await page.getByRole('button', { name: 'Add to queue' }).click();
    await page.getByTestId('queue').locator('li b').getByText('model 15°').waitFor();
    expect(await page.getByRole('button', { name: 'Start scan' }).count()).toBe(0);
  });

  it('keeps what is typed of a new part while the recipes are read again', async () => {
    daemon.recipes.add({ name: 'PX-1204', plan: { preset: 'paper' }, material: { eta: 1.54 } });
    await page.goto(url);
    await page.getByTestId('next-part').waitFor();
    await page.getByRole('navigation', { name: 'Views' }).getByRole('link', { name: 'Set-up' }).click();
    await page.getByRole('button', { name: 'New recipe' }).waitFor();
    let answer = (): void => undefined;
    const held = new Promise<void>((go) => (answer = go));
    await page.route('**/api/v1/recipes?*', async (route) => {
      await held;
      await route.continue();
    });
    await page.getByRole('navigation', { name: 'Views' }).getByRole('link', { name: 'Measure' }).click();
    await chooseSample('New part …');
    const name = page.getByTestId('sample-form').getByLabel('Name', { exact: true });
    await name.fill('B-17');
    const read = page.waitForResponse(/\/api\/v1\/recipes\?/);
    answer();
    await (await read).finished();
    await page.waitForTimeout(200);
    expect(await name.inputValue()).toBe('B-17');
  });

  it('needs a recipe, and says where one is made', async () => {
    await page.goto(url);
    await chooseSample();
    await page.getByText('53 frames').waitFor();
    expect(await page.getByRole('button', { name: 'Add to queue' }).isDisabled()).toBe(true);
    await page.getByRole('link', { name: 'Make one in Set-up.' }).click();
    await page.getByRole('button', { name: 'New recipe' }).waitFor();
  });
});
