// The daemon speaks to terminals, scripts and this page alike: what it calls by flag or key is said here as the page has it.

import { PARAMETERS } from './words';

const SAID: readonly (readonly [RegExp, string])[] = [
  [/`--surfaces N` shows/g, '“Surfaces, drawn anew” shows'],
  [/\b(state|set) `?rig\.(\w+)`?/gi, '$1 it in the rig’s settings ($2)'],
  [/\btheta_l\b/g, 'the angle between lamp and camera'],
  [/^theta_c(?= has| is|:)/i, 'the camera tilt'],
  [/^phi_s(?= has| is|:)/i, 'the sample azimuth'],
  [/\bof theta_c\b/g, 'of the camera tilt'],
  [/\bof phi_s\b/g, 'of the sample azimuth'],
  [/\btheta_c\b/g, 'camera tilt'],
  [/\bphi_s\b/g, 'sample azimuth'],
  [/`([^`\n]*)`/g, '“$1”'],
];

/** Names of single letters or whole words are none that a sentence could not have by itself. */
const NAMES = Object.entries(PARAMETERS)
  .filter(([key]) => key.includes('_'))
  .map(([key, { name }]): readonly [RegExp, string] => [new RegExp(`\\b${key}\\b`, 'g'), name]);

export function pageWords(text: string): string {
  return SAID.reduce((said, [theirs, ours]) => said.replace(theirs, ours), text);
}

/** What a result says of its parameters. Refusals keep the keys: of a scene they are what was written. */
export function resultWords(text: string): string {
  return NAMES.reduce((said, [key, name]) => said.replace(key, name), pageWords(text));
}
