// Rows of `GET /results`, page by page. They are read again, as many as are shown, when the daemon reports a change.

import { live } from './live.svelte';
import { spoken } from './problems';
import { studyApi } from './studyapi';
import type { ResultRow } from './types';

export const ROWS_PER_PAGE = 100;
const ROWS_MAX = 1000;

/** Changes with scans, fits, verdicts and names, but not with each frame: results are read again then. */
export function resultsMark(): string {
  return [live.scans.length, live.activeScan?.id, live.fits.filter((f) => f.state === 'completed').length, live.jobsChanged, live.samples.map((s) => s.name).join()].join(' ');
}

export class ResultList {
  rows = $state.raw<readonly ResultRow[]>([]);
  /** Number of all rows that the filters select; null before the first answer. */
  total = $state<number | null>(null);
  failure = $state<string | null>(null);
  more = $state(false);
  #cursor: string | null = null;
  #query = '';
  #abort = new AbortController();

  /** Reads the rows of a query from the start: one page of another query, as many as are shown of the same one. */
  async read(query: string): Promise<void> {
    const wanted = query === this.#query ? Math.max(this.rows.length, ROWS_PER_PAGE) : ROWS_PER_PAGE;
    this.#query = query;
    await this.#take([], null, wanted);
  }

  /** Reads the next page. */
  async next(): Promise<void> {
    if (this.#cursor !== null) await this.#take(this.rows, this.#cursor, this.rows.length + ROWS_PER_PAGE);
  }

  async #take(before: readonly ResultRow[], from: string | null, wanted: number): Promise<void> {
    this.#abort.abort();
    const { signal } = (this.#abort = new AbortController());
    try {
      let rows = before;
      let cursor = from;
      let total = this.total;
      do {
        const page = await studyApi.results(this.#query, { limit: Math.min(ROWS_MAX, wanted - rows.length), cursor }, signal);
        rows = [...rows, ...page.items];
        cursor = page.next_cursor;
        total = page.count ?? total;
      } while (cursor !== null && rows.length < wanted);
      // An older answer may arrive after a newer question.
      if (signal.aborted) return;
      [this.rows, this.total, this.#cursor, this.more, this.failure] = [rows, total, cursor, cursor !== null, null];
    } catch (error) {
      if (!signal.aborted) this.failure = spoken(error);
    }
  }

  end(): void {
    this.#abort.abort();
  }
}
