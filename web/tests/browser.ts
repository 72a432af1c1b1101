// Starts headless Chromium for the tests of the page, with its own profile, which is removed afterwards.

import { existsSync } from 'node:fs';
import { mkdtemp, rm } from 'node:fs/promises';
import { tmpdir } from 'node:os';
import { join } from 'node:path';

import { chromium, type BrowserContext } from 'playwright-core';

// The build without a window takes half the processor time of the one that hides it.
const CHROMIUM = process.env['CHROMIUM'] ?? '/usr/bin/chromium-headless-shell';

export interface OpenBrowser {
  readonly context: BrowserContext;
  close(): Promise<void>;
}

/** A missing browser is a failure that names the command that installs it, never a skipped test. */
export async function openBrowser(options: { width?: number; height?: number; scale?: number; dark?: boolean } = {}): Promise<OpenBrowser> {
  if (!existsSync(CHROMIUM)) {
    throw new Error(`no browser at ${CHROMIUM}: apt-get install -y chromium-headless-shell (or set CHROMIUM to another one)`);
  }
  const profile = await mkdtemp(join(tmpdir(), 'ridged-page-'));
  const context = await chromium.launchPersistentContext(profile, {
    executablePath: CHROMIUM,
    headless: true,
    args: [
      '--headless', '--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run', '--disable-background-networking', '--disable-component-update', '--disable-sync',
    ],
    viewport: { width: options.width ?? 1440, height: options.height ?? 900 },
    deviceScaleFactor: options.scale ?? 1,
    colorScheme: options.dark === true ? 'dark' : 'light',
  });
  return {
    context,
    async close() {
      await context.close();
      await rm(profile, { recursive: true, force: true });
    },
  };
}
