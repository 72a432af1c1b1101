// The newest finished fits of several scans, for comparisons.

import { api } from './api';
import type { Fit } from './types';

export interface ScanFit {
  readonly scanId: number;
  /** Null without a finished fit. */
  readonly fit: Fit | null;
}

export async function readScanFits(scanIds: readonly number[], signal: AbortSignal): Promise<ScanFit[]> {
  return Promise.all(
    scanIds.map(async (scanId) => {
      const { items } = await api.fits({ scan_id: scanId }, signal);
      return { scanId, fit: items.find((f) => f.state === 'completed' && f.parameters !== undefined) ?? null };
    }),
  );
}
