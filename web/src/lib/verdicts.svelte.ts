// The verdicts of the newest results, by scan: one word each, for lists and for the head of a result.

import { api } from './api';
import type { VerdictWord } from './types';

/** More results are not asked for: lists that show verdicts are shorter. */
const NEWEST = 50;
/** Of several regions of a part, the worst one counts. */
const WORST: readonly VerdictWord[] = ['fail', 'cannot-tell', 'pass'];

class Verdicts {
  #words = $state.raw<ReadonlyMap<number, VerdictWord>>(new Map());

  of(scanId: number): VerdictWord | null {
    return this.#words.get(scanId) ?? null;
  }

  /** Without an answer, the words read so far stay. */
  async read(signal?: AbortSignal): Promise<void> {
    const rows = await api.verdictWords(NEWEST, signal);
    const words = new Map<number, VerdictWord>();
    for (const { scan_id, verdict } of rows) {
      const known = words.get(scan_id);
      if (verdict != null && (known === undefined || WORST.indexOf(verdict) < WORST.indexOf(known))) words.set(scan_id, verdict);
    }
    this.#words = words;
  }
}

export const verdicts = new Verdicts();
