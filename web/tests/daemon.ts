// Starts and ends the real daemon on a simulated rig, in its own folder.

import { spawn, type ChildProcess } from 'node:child_process';
import { existsSync } from 'node:fs';
import { mkdtemp, rm } from 'node:fs/promises';
import { tmpdir } from 'node:os';
import { join, resolve } from 'node:path';
import { createInterface } from 'node:readline';

const BINARY = resolve(process.env['RIDGED_BIN'] ?? join(import.meta.dirname, '../../target/debug/ridged'));
/** Ample time for a debug binary to open its store. */
const READY_MS_MAX = 40_000;

export interface RunningDaemon {
  readonly url: string;
  /** Its standard error, for the message of a failing test. */
  readonly log: () => string;
  stop(): Promise<void>;
}

export async function startDaemon(timeScale: number): Promise<RunningDaemon> {
  if (!existsSync(BINARY)) throw new Error(`no daemon at ${BINARY}: cargo build (or set RIDGED_BIN)`);
  const folder = await mkdtemp(join(tmpdir(), 'ridged-e2e-'));
  const child: ChildProcess = spawn(
    BINARY,
    ['serve', '--simulated-rig', '--listen', '127.0.0.1:0', '--time-scale', String(timeScale), '--data', join(folder, 'data')],
    { cwd: folder, stdio: ['ignore', 'pipe', 'pipe'] },
  );
  let log = '';
  child.stderr?.on('data', (part: Buffer) => {
    log = (log + part.toString()).slice(-20_000);
  });
  const ended = new Promise<void>((done) => child.once('exit', () => done()));
  const stop = async (): Promise<void> => {
    child.kill('SIGINT');
    const slow = setTimeout(() => child.kill('SIGKILL'), 10_000);
    await ended;
    clearTimeout(slow);
    await rm(folder, { recursive: true, force: true });
  };
  const stdout = child.stdout;
  if (!stdout) throw new Error('the daemon has no standard output');
  const url = await new Promise<string>((found, failed) => {
    const late = setTimeout(() => failed(new Error(`the daemon did not say where it listens:\n${log}`)), READY_MS_MAX);
    createInterface({ input: stdout }).on('line', (line) => {
      const [, address] = /^listening on (http:\/\/\S+)/.exec(line) ?? [];
      if (address !== undefined) {
        clearTimeout(late);
        found(address);
      }
    });
    void ended.then(() => {
      clearTimeout(late);
      failed(new Error(`the daemon ended before it listened:\n${log}`));
    });
  }).catch(async (error: unknown) => {
    await stop();
    throw error;
  });
  return { url, log: () => log, stop };
}
