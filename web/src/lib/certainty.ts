// The rows of the fit that runs along with a scan as lines over the rig's minutes.

import type { Certainty } from './types';

/** Drawn in this order, in the colours of the same place. */
export const DRAWN = ['theta_r_deg', 'alpha_u', 'alpha_v', 'rho_d'] as const;

export interface FallingLine {
  readonly name: string;
  /** Standard uncertainty per row; null where the frames could not tell yet. */
  readonly std: readonly (number | null)[];
  /** Newest estimate and uncertainty. */
  readonly now: { readonly value: number; readonly std: number } | null;
}

/** Rows of both lists in the order of the rig's time, each once. */
export function merged(kept: readonly Certainty[], fresh: readonly Certainty[]): Certainty[] {
  const rows = new Map([...kept, ...fresh].map((row) => [row.id, row]));
  return [...rows.values()].sort((a, b) => a.elapsed_s - b.elapsed_s || a.id - b.id);
}

/** Lines of the parameters that any row knows. */
export function fallingLines(rows: readonly Certainty[]): FallingLine[] {
  const lines = DRAWN.map((name): FallingLine => {
    const known = rows.map((row) => row.parameters[name] ?? null);
    return { name, std: known.map((p) => p?.std ?? null), now: known.findLast((p) => p !== null) ?? null };
  });
  return lines.filter((line) => line.now !== null);
}

/** Range of a logarithmic scale that holds all lines, with room above and below. */
export function decades(lines: readonly FallingLine[]): [number, number] {
  const all = lines.flatMap((line) => line.std.filter((s): s is number => s !== null && s > 0));
  if (all.length === 0) return [1e-3, 1];
  return [Math.min(...all) / 1.5, Math.max(...all) * 1.5];
}
