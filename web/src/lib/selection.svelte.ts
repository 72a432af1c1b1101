// The shown view, scan and fit, kept in the address so that reloads, links and the back button work.

import { isCalibration } from './calibrations';
import { live } from './live.svelte';
import { parseRoute, resultHash, type Route } from './route';
import type { Fit, Scan } from './types';

class Selection {
  route = $state.raw<Route>(parseRoute(''));
  /** Region of the shown scan's part, if it has several: one choice for curves, fits and calculations. */
  region = $state<string | null>(null);

  start(): () => void {
    const read = (): void => {
      this.route = parseRoute(location.hash);
    };
    read();
    addEventListener('hashchange', read);
    return () => removeEventListener('hashchange', read);
  }

  get scanId(): number | null {
    return this.route.scans[0] ?? null;
  }

  get fitId(): number | null {
    return this.route.fit;
  }

  /** Shows a result, and of it the part that is shown now. */
  show(scanId: number, fitId: number | null = null): void {
    location.hash = resultHash(scanId, fitId, this.route.view === 'result' ? this.route.tab : null);
  }

  /** The chosen scan, else the running one, else the newest. If the chosen scan does not exist, no other one replaces it. */
  get scan(): Scan | null {
    if (this.scanId !== null) return live.scan(this.scanId);
    return live.activeScan ?? live.scans[0] ?? null;
  }

  /** The scan at the rig: the running one, else its newest. */
  get atRig(): Scan | null {
    return live.activeScan ?? live.scans.find((s) => s.origin === 'rig' && !isCalibration(s)) ?? null;
  }

  /** Fits of the shown scan, newest first. */
  get fits(): readonly Fit[] {
    return this.fitsOf(this.scan);
  }

  fitsOf(scan: Scan | null): readonly Fit[] {
    return live.fits.filter((f) => f.scan_id === scan?.id).sort((a, b) => b.id - a.id);
  }

  /** The chosen fit of the shown scan, else its newest. */
  get fit(): Fit | null {
    if (this.fitId !== null) return this.fits.find((f) => f.id === this.fitId) ?? null;
    return this.fits[0] ?? null;
  }

  /** What the address names but the store does not have. */
  get missing(): 'scan' | 'fit' | null {
    if (!live.loaded) return null;
    if (this.scanId !== null && this.scan === null) return live.absent.includes(this.scanId) ? 'scan' : null;
    // An older fit may not have been read yet.
    const all = !live.moreFits || live.fitsOfScan === this.scanId;
    return all && this.fitId !== null && this.fit === null ? 'fit' : null;
  }
}

export const selection = new Selection();
