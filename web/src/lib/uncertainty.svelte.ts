// The rows of the live fit of the shown scan, which two cards show, and the target that the user sets.

import { api } from './api';
import { merged } from './certainty';
import { live } from './live.svelte';
import { typed } from './typed';
import type { Certainty } from './types';

const KEY = 'ridged.target_theta_r_deg';

function storedTarget(): string {
  try {
    return localStorage.getItem(KEY) ?? '';
  } catch {
    return '';
  }
}

class Uncertainty {
  #scanId = $state<number | null>(null);
  #kept = $state.raw<readonly Certainty[]>([]);
  #target = $state(storedTarget());

  /** Reads the rows of a scan, and returns how to stop. */
  follow(scanId: number): () => void {
    const abort = new AbortController();
    this.#scanId = scanId;
    this.#kept = [];
    // Without the earlier rows the list starts with the next one; no notice is needed.
    api.certainties(scanId, abort.signal).then((rows) => (this.#kept = rows)).catch(() => undefined);
    return () => abort.abort();
  }

  /** Rows of a scan in order; empty for one that is not followed. */
  of(scanId: number): readonly Certainty[] {
    if (scanId !== this.#scanId) return [];
    return merged(this.#kept, live.freshCertainties.filter((c) => c.scan_id === scanId));
  }

  /** Text of the field of the target. */
  get target(): string {
    return this.#target;
  }

  set target(text: string) {
    this.#target = text;
    try {
      localStorage.setItem(KEY, text);
    } catch {
      // It holds until the page is closed.
    }
  }

  /** The expanded uncertainty of θr that is needed, degrees; null without one, NaN for invalid text. */
  get targetDeg(): number | null {
    const value = typed(this.#target);
    return value === null || value > 0 ? value : Number.NaN;
  }
}

export const uncertainty = new Uncertainty();
