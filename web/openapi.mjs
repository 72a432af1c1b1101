// Makes src/lib/openapi.ts, the types of the schemas in the daemon's OpenAPI document: `npm run types`. The installation of the
// packages and the check of the types do so, too.

import { existsSync, readFileSync, writeFileSync } from 'node:fs';

import openapiTS, { astToString } from 'openapi-typescript';

const DOCUMENT = new URL('../src/api/openapi.json', import.meta.url);
const FILE = new URL('./src/lib/openapi.ts', import.meta.url);

const document = JSON.parse(readFileSync(DOCUMENT, 'utf8'));
// The routes are not in it: `api.ts` has them by hand.
const ast = await openapiTS({ ...document, paths: {} }, { immutable: true, rootTypes: true, rootTypesNoSchemaPrefix: true });
const types = `// Made from src/api/openapi.json by \`npm run types\`; do not edit.\n\n${astToString(ast)}`;
// An unchanged file keeps its time, so that the page is not built again.
if (!existsSync(FILE) || readFileSync(FILE, 'utf8') !== types) writeFileSync(FILE, types);
