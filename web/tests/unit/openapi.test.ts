import { readFileSync } from 'node:fs';

import { expect, it } from 'vitest';

import { FILE, types } from '../../openapi.mjs';

it('the types of the bodies are those of the OpenAPI document', async () => {
  // Otherwise run `npm run types`.
  expect(readFileSync(FILE, 'utf8')).toBe(await types());
});
