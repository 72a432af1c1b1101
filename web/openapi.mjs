// Makes src/lib/openapi.ts, the types of the schemas in the daemon's OpenAPI document: `npm run types`.

import { readFileSync, writeFileSync } from 'node:fs';
import { fileURLToPath } from 'node:url';

import openapiTS, { astToString } from 'openapi-typescript';

const DOCUMENT = new URL('../src/api/openapi.json', import.meta.url);
export const FILE = new URL('./src/lib/openapi.ts', import.meta.url);

/** Returns the text of the file. The routes are not in it: `api.ts` has them by hand. */
export async function types() {
  const document = JSON.parse(readFileSync(DOCUMENT, 'utf8'));
  const ast = await openapiTS({ ...document, paths: {} }, { immutable: true, rootTypes: true, rootTypesNoSchemaPrefix: true });
  return `// Made from src/api/openapi.json by \`npm run types\`; do not edit.\n\n${astToString(ast)}`;
}

if (process.argv[1] === fileURLToPath(import.meta.url)) writeFileSync(FILE, await types());
