// The shown scan and fit, kept in the address so that reloads and links work.

import { live } from './live.svelte';
import type { Fit, Scan } from './types';

class Selection {
  scanId = $state<number | null>(null);
  fitId = $state<number | null>(null);
  /** Region of the shown scan's sample, if it has several: one choice for curves, fits and calculations. */
  region = $state<string | null>(null);

  start(): () => void {
    const read = (): void => {
      const [, scan, fit] = /^#\/scan\/(\d+)(?:\/fit\/(\d+))?/.exec(location.hash) ?? [];
      this.scanId = scan === undefined ? null : Number(scan);
      this.fitId = fit === undefined ? null : Number(fit);
    };
    read();
    addEventListener('hashchange', read);
    return () => removeEventListener('hashchange', read);
  }

  show(scanId: number, fitId: number | null = null): void {
    location.hash = `#/scan/${scanId}${fitId === null ? '' : `/fit/${fitId}`}`;
  }

  /** The chosen scan, else the running one, else the newest. If the chosen scan does not exist, no other one replaces it. */
  get scan(): Scan | null {
    if (this.scanId !== null) return live.scans.find((s) => s.id === this.scanId) ?? null;
    return live.activeScan ?? live.scans[0] ?? null;
  }

  /** Fits of the shown scan, newest first. */
  get fits(): readonly Fit[] {
    const id = this.scan?.id;
    return live.fits.filter((f) => f.scan_id === id).sort((a, b) => b.id - a.id);
  }

  /** The chosen fit of the shown scan, else its newest. */
  get fit(): Fit | null {
    if (this.fitId !== null) return this.fits.find((f) => f.id === this.fitId) ?? null;
    return this.fits[0] ?? null;
  }

  /** What the address names but the store does not have. */
  get missing(): 'scan' | 'fit' | null {
    if (!live.loaded) return null;
    if (this.scanId !== null && this.scan === null) return 'scan';
    // An older fit may not have been read yet.
    const all = !live.moreFits || live.fitsOfScan === this.scanId;
    return all && this.fitId !== null && this.fit === null ? 'fit' : null;
  }
}

export const selection = new Selection();
