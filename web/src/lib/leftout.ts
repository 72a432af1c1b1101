// Terms that a calculation omits, sorted for reading.

import type { LeftOut } from './types';

/** Terms with an error, largest first, then those of unknown error; and terms without any error. */
export function leftOutByCost(items: readonly LeftOut[]): { readonly costly: readonly LeftOut[]; readonly free: readonly LeftOut[] } {
  const known = items.filter((item) => item.cost != null && item.cost !== 0).sort((a, b) => (b.cost ?? 0) - (a.cost ?? 0));
  return { costly: [...known, ...items.filter((item) => item.cost == null)], free: items.filter((item) => item.cost === 0) };
}
