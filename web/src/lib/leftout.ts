// What a calculation does without, in the order in which a reader wants it.

import type { LeftOut } from './types';

/** What costs something, the costliest first, then what nobody knows the cost of; and what costs nothing. */
export function leftOutByCost(items: readonly LeftOut[]): { readonly costly: readonly LeftOut[]; readonly free: readonly LeftOut[] } {
  const known = items.filter((item) => item.cost != null && item.cost !== 0).sort((a, b) => (b.cost ?? 0) - (a.cost ?? 0));
  return { costly: [...known, ...items.filter((item) => item.cost == null)], free: items.filter((item) => item.cost === 0) };
}
