// Example scenes, and names of traced scenes.

import crystals from '../../../scenes/sandpaper.toml?raw';
import diamond from '../../../scenes/glass-over-diamond.toml?raw';
import gold from '../../../scenes/glass-over-gold.toml?raw';
import ridges from '../../../scenes/ridged-plastic.toml?raw';
import { significant, withUncertainty } from './format';
import { newScene, type SceneDraft } from './sceneform';
import type { Estimated } from './types';

interface Example {
  readonly name: string;
  readonly text: string;
  /** The fields that make it; null if the form cannot make it. */
  readonly draft: SceneDraft | null;
}

/** A rough layer of glass over a rough surface, as in Wang et al. 2017. */
const GLASS: SceneDraft = { ...newScene(), surface: 'rough', alphaU: '0.1', rhoD: '', layer: true, layerN: '1.5', layerAlpha: '0.1', azimuth: '180' };

export const EXAMPLES: readonly Example[] = [
  { name: 'ridges on plastic', text: withoutCommands(ridges), draft: newScene() },
  { name: 'rough glass over gold', text: withoutCommands(gold), draft: { ...GLASS, material: 'Au', angles: '60' } },
  { name: 'rough glass over diamond', text: withoutCommands(diamond), draft: { ...GLASS, n: '2.4', angles: '65' } },
  { name: 'gold-coated sandpaper', text: withoutCommands(crystals), draft: null },
];

/** A scene without the comments about the command line. */
export function withoutCommands(scene: string): string {
  return scene.replace(/^#\s+ridged .*\n/gm, '');
}

/** The first line of a scene where it is a comment, else its shapes from the top down. */
export function titleOf(scene: unknown): string {
  if (typeof scene === 'string') {
    const [, comment] = /^\s*#+\s*(.+)/.exec(scene) ?? [];
    if (comment !== undefined) return comment.trim().replace(/\.$/, '');
    const shapes = [...scene.matchAll(/^\s*shape\s*=\s*["'](\w+)["']/gm)].map((match) => match[1]);
    return shapes.length > 0 ? shapes.join(' over ') : 'scene';
  }
  const { interface: interfaces } = (scene ?? {}) as { interface?: readonly { shape?: unknown }[] };
  return Array.isArray(interfaces) && interfaces.length > 0 ? interfaces.map((i) => String(i.shape)).join(' over ') : 'scene';
}

/** A typed whole number: `1e6`, `1 000 000`, `1_000_000`. Null if empty, NaN if it is not one. */
export function typedCount(text: string): number | null {
  const plain = text.replace(/[\s_\u202f]/g, '');
  if (plain === '') return null;
  const x = /^\d+(\.\d+)?(e\d+)?$/i.test(plain) ? Number(plain) : Number.NaN;
  return Number.isInteger(x) && x > 0 ? x : Number.NaN;
}

/** Numbers of the trace form: null if empty, NaN if not a number. */
export type TraceField = 'count' | 'limit' | 'target' | 'others';

/** What is wrong with them, field by field. */
export function traceFaults(read: Readonly<Record<TraceField, number | null>>): Partial<Record<TraceField, string>> {
  const found: Partial<Record<TraceField, string>> = {};
  if (read.count !== null && !(read.count > 0)) found.count = 'Give a whole number above 0, e.g. 200000 or 2e5.';
  if (read.limit !== null && !(read.limit > 0)) found.limit = 'Give a number of seconds above 0, or leave it empty for no limit.';
  if (read.target !== null && !(read.target > 0)) found.target = 'Give a percentage above 0, or leave it empty for no target.';
  if (read.others !== null && !(read.others >= 2 && read.others <= 1000)) found.others = 'Give a whole number from 2 to 1000, or leave it empty.';
  return found;
}

/** Whether a scene has ridges, so that an effective angle is defined. */
export function hasRidges(scene: unknown): boolean {
  return /shape"?\s*[=:]\s*["'](ridges|profile|file)["']/.test(typeof scene === 'string' ? scene : JSON.stringify(scene ?? null));
}

/** A mean with U (k = 2), of which an estimate states the standard error. */
export function estimateWords({ value, std }: Estimated): string {
  if (value === 0 && !std) return '0';
  if (std === null || std <= 0) return significant(value, 4);
  if (std < 1e-8) return `${significant(value, 6)} ± ${significant(2 * std, 1)}`;
  const both = withUncertainty(value, 2 * std);
  return `${both.value} ± ${both.uncertainty}`;
}

export interface Order {
  /** R or T and the number of interactions: `3`, `16+`; no letter for the sum of the small ones. */
  readonly letter: string;
  readonly order: string;
  readonly value: number;
  readonly std: number | null;
}

/** Smaller shares are summed. */
const SHOWN_MIN = 1e-3;

/** Energies by number of interactions; the small ones of both sides are summed as if independent. */
export function ordersOf(byInteractions: Readonly<Record<string, Estimated>>): Order[] {
  const all = Object.entries(byInteractions)
    .map(([name, e]) => ({ letter: name.slice(0, 1), order: name.slice(1).replace('plus', '+'), ...e }))
    .filter((e) => e.value > 0)
    .sort((a, b) => a.letter.localeCompare(b.letter) || Number.parseInt(a.order) - Number.parseInt(b.order));
  const small = all.filter((e) => e.value < SHOWN_MIN);
  if (small.length < 2) return all;
  const rest = { letter: '', order: '', value: small.reduce((sum, e) => sum + e.value, 0), std: Math.hypot(...small.map((e) => e.std ?? 0)) };
  return [...all.filter((e) => e.value >= SHOWN_MIN), rest];
}
