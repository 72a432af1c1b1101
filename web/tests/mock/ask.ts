// A request to the mock daemon, and the ways to answer it.

import type { IncomingHttpHeaders, ServerResponse } from 'node:http';

export type Json = Record<string, unknown>;

/** Each way to answer returns true: the request is answered. */
export interface Ask {
  readonly method: string;
  /** Below `/api/v1`. */
  readonly path: string;
  readonly query: URLSearchParams;
  readonly body: Json;
  readonly headers: IncomingHttpHeaders;
  readonly response: ServerResponse;
  send(status: number, answer: unknown, type?: string): true;
  list(items: readonly unknown[]): true;
  problem(status: number, code: string, detail: string): true;
}
