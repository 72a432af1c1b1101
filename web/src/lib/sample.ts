// A part in words. What is typed for a new one is read by `newsample.ts`, which the first view does not need.

import { plain } from './format';
import type { Material, Sample } from './types';

/** `n 1.54`, `n 3.12, κ 3.33`. */
function indexWords(material: Material): string {
  return `n ${plain(material.eta, 4)}${material.kind === 'conductor' ? `, κ ${plain(material.k, 4)}` : ''}`;
}

/** A part in a list. Parts with the same name and index are distinguished by their numbers. */
export function sampleWords(sample: Sample, all: readonly Sample[]): string {
  const words = `${sample.name} (${indexWords(sample.material)})`;
  const alike = all.some((s) => s.id !== sample.id && s.name === sample.name && indexWords(s.material) === indexWords(sample.material));
  return alike ? `${words}, no. ${sample.id}` : words;
}
