// The verdicts of the newest results, by scan: one word each, for lists and for the head of a result.

import { api } from './api';
import type { VerdictWord } from './types';

/** More results are not asked for: lists that show verdicts are shorter. */
const NEWEST = 50;
/** Of several regions of a part, the worst one counts. */
const WORST: readonly VerdictWord[] = ['fail', 'cannot-tell', 'pass'];

interface RowVerdict {
  readonly word: VerdictWord;
  /** Whether it judged the values of the newest fit. */
  readonly matches: boolean | null;
}

class Verdicts {
  #words = $state.raw<ReadonlyMap<number, RowVerdict>>(new Map());

  of(scanId: number): RowVerdict | null {
    return this.#words.get(scanId) ?? null;
  }

  /** Without an answer, the words read so far stay. */
  async read(signal?: AbortSignal): Promise<void> {
    const rows = await api.verdictWords(NEWEST, signal);
    const words = new Map<number, RowVerdict>();
    for (const { scan_id, verdict, verdict_matches = null } of rows) {
      const known = words.get(scan_id);
      if (verdict != null && (known === undefined || WORST.indexOf(verdict) < WORST.indexOf(known.word))) words.set(scan_id, { word: verdict, matches: verdict_matches });
    }
    this.#words = words;
  }
}

export const verdicts = new Verdicts();
