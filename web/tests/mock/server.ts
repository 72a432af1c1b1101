// A mock daemon for tests of the page: the bodies of /api/v1 with invented optics, on its own
// loopback port. The real daemon is tested by tests/e2e.

import { readFile } from 'node:fs/promises';
import { createServer, type IncomingMessage, type Server, type ServerResponse } from 'node:http';
import type { AddressInfo } from 'node:net';
import { extname, join, normalize } from 'node:path';

import type { Ask, Json } from './ask';
import { MockLab } from './lab';
import { answerAccess } from './routes/access';
import { answerJobs } from './routes/jobs';
import { answerParts } from './routes/parts';
import { answerResults } from './routes/results';
import { answerRig } from './routes/rig';
import { answerScans } from './routes/scans';

const TYPES: Record<string, string> = {
  '.html': 'text/html; charset=utf-8',
  '.js': 'text/javascript',
  '.css': 'text/css',
  '.svg': 'image/svg+xml',
  '.woff2': 'font/woff2',
  '.txt': 'text/plain; charset=utf-8',
};
/** In this order: a request without a session gets no further than the first. */
const ROUTES: readonly ((lab: MockLab, ask: Ask) => boolean)[] = [answerAccess, answerEvents, answerRig, answerParts, answerScans, answerResults, answerJobs];

interface MockSettings {
  /** Milliseconds per frame of a scan. */
  readonly frameMs: number;
  readonly dist: string;
}

export class MockDaemon extends MockLab {
  readonly #server: Server;
  readonly #dist: string;

  constructor(settings: MockSettings) {
    super(settings.frameMs);
    this.#dist = settings.dist;
    this.#server = createServer((request, response) => {
      this.#answer(request, response).catch((error: unknown) => {
        response.writeHead(500).end(String(error));
      });
    });
  }

  async start(port = 0): Promise<string> {
    await new Promise<void>((resolve) => this.#server.listen(port, '127.0.0.1', resolve));
    return `http://127.0.0.1:${(this.#server.address() as AddressInfo).port}`;
  }

  async stop(): Promise<void> {
    this.timers.forEach(clearTimeout);
    this.dropStreams();
    this.#server.closeAllConnections();
    await new Promise<void>((resolve) => this.#server.close(() => resolve()));
  }

  async #answer(request: IncomingMessage, response: ServerResponse): Promise<void> {
    const url = new URL(request.url ?? '/', 'http://mock');
    const method = request.method ?? 'GET';
    if (!url.pathname.startsWith('/api/v1')) return this.#file(url.pathname, response);
    const path = url.pathname.slice('/api/v1'.length);
    let text = '';
    for await (const part of request) text += String(part);
    const isArchive = request.headers['content-type'] === 'application/zip';
    const body = (isArchive ? { archive: text } : text === '' ? {} : JSON.parse(text)) as Json;
    if (method === 'POST' || method === 'PATCH') this.requests.push({ method, path, body });
    else this.reads.push(path + url.search);

    const send: Ask['send'] = (status, answer, type = 'application/json') => {
      response.writeHead(status, { 'content-type': type });
      response.end(answer instanceof Uint8Array ? answer : JSON.stringify(answer));
      return true;
    };
    const list: Ask['list'] = (items) => send(200, { items, next_cursor: null });
    const problem: Ask['problem'] = (status, code, detail) => send(status, { status, code, title: code, detail }, 'application/problem+json');
    const refusal = this.refusals.get(`${method} ${path}`);
    if (refusal) {
      send(refusal.status, refusal.body, 'application/problem+json');
      return;
    }
    const ask: Ask = { method, path, query: url.searchParams, body, headers: request.headers, response, send, list, problem };
    if (!ROUTES.some((route) => route(this, ask))) problem(404, 'not-found', `there is no ${path}`);
  }

  async #file(path: string, response: ServerResponse): Promise<void> {
    const name = normalize(path === '/' ? '/index.html' : path);
    try {
      const bytes = await readFile(join(this.#dist, name));
      response.writeHead(200, { 'content-type': TYPES[extname(name)] ?? 'application/octet-stream' }).end(bytes);
    } catch {
      response.writeHead(404).end();
    }
  }
}

function answerEvents(lab: MockLab, { path, response }: Ask): boolean {
  if (path !== '/events') return false;
  response.writeHead(200, { 'content-type': 'text/event-stream', 'cache-control': 'no-store' });
  response.write(': here\n\n');
  lab.streams.add(response);
  response.on('close', () => lab.streams.delete(response));
  return true;
}
