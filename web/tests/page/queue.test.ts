// The queue on the page with a mock daemon: orders are added, moved and removed, and the queue is started.

import { describe, expect, it } from 'vitest';

import { daemon, page, posts, url } from './stage';

describe('the queue', () => {
  it('takes parts in sequence and starts', async () => {
    daemon.recipes.push({ id: 1, name: 'PX-1204', version: 2, newest_version: 2, archived: false, who: 'local', saved_at: '2026-01-01T00:00:00.000Z', recipe: { name: 'PX-1204' } });
    await page.goto(url);
    const card = page.getByTestId('queue');
    for (const [part, id] of [['B-17', 'A-1'], ['B-18', 'A-2']] as const) {
      await card.getByLabel('Part').fill(part);
      await card.getByLabel('External id').fill(id);
      await card.getByRole('button', { name: 'Add to the queue' }).click();
      await card.getByText(part, { exact: true }).waitFor();
    }
    // The only recipe is chosen without a click.
    expect(daemon.orders.map((o) => [o['part'], (o['recipe'] as { name: string }).name, o['external_id']])).toEqual([['B-17', 'PX-1204', 'A-1'], ['B-18', 'PX-1204', 'A-2']]);
    await card.getByRole('button', { name: 'Move B-18 up' }).click();
    await expect.poll(() => card.locator('li b').allTextContents()).toEqual(['B-18', 'B-17']);
    await card.getByRole('button', { name: 'Remove B-17' }).click();
    await expect.poll(() => card.locator('li b').allTextContents()).toEqual(['B-18']);
    await card.getByRole('button', { name: 'Start the queue' }).click();
    await card.getByRole('button', { name: 'Stop after this one' }).waitFor();
    expect(posts().at(-1)).toBe('/queue/start');
  });

  it('says how a recipe is made where there is none', async () => {
    await page.goto(url);
    await page.getByTestId('queue').getByText('ridged recipe save FILE.toml').waitFor();
  });
});
