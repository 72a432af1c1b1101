// Scenes to begin a trace with, and what to call one that was traced.

import crystals from '../../../scenes/sandpaper.toml?raw';
import diamond from '../../../scenes/glass-over-diamond.toml?raw';
import gold from '../../../scenes/glass-over-gold.toml?raw';
import ridges from '../../../scenes/ridged-plastic.toml?raw';
import type { Estimated } from './types';

export interface Example {
  readonly name: string;
  readonly text: string;
}

/** The first one stands in an empty form. */
export const EXAMPLES: readonly Example[] = [
  { name: 'rough glass over gold', text: withoutCommands(gold) },
  { name: 'rough glass over diamond', text: withoutCommands(diamond) },
  { name: 'ridges on plastic', text: withoutCommands(ridges) },
  { name: 'gold-coated sandpaper', text: withoutCommands(crystals) },
];

/** A scene without the comments that say how the command line traces it. */
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

/** A whole number as people type it: `1e6`, `1 000 000`, `1_000_000`; null where nothing is written, NaN where it is none. */
export function typedCount(text: string): number | null {
  const plain = text.replace(/[\s_\u202f]/g, '');
  if (plain === '') return null;
  const x = /^\d+(\.\d+)?(e\d+)?$/i.test(plain) ? Number(plain) : Number.NaN;
  return Number.isInteger(x) && x > 0 ? x : Number.NaN;
}

/** Numbers of the form of a trace as they were read: null where nothing is written, NaN where it is none. */
export type TraceField = 'count' | 'limit' | 'target' | 'others';

/** What is wrong with them, field by field. */
export function traceFaults(read: Readonly<Record<TraceField, number | null>>): Partial<Record<TraceField, string>> {
  const found: Partial<Record<TraceField, string>> = {};
  if (read.count !== null && !(read.count > 0)) found.count = 'A whole number above 0, such as 200000 or 2e5.';
  if (read.limit !== null && !(read.limit > 0)) found.limit = 'A number of seconds above 0, or nothing for no limit.';
  if (read.target !== null && !(read.target > 0)) found.target = 'A number of per cent above 0, or nothing for no target.';
  if (read.others !== null && !(read.others >= 2 && read.others <= 1000)) found.others = 'A whole number from 2 to 1000, or nothing.';
  return found;
}

/** Whether a scene has ridges, whose effective angle means something. */
export function hasRidges(scene: unknown): boolean {
  return /shape"?\s*[=:]\s*["'](ridges|profile|file)["']/.test(typeof scene === 'string' ? scene : JSON.stringify(scene ?? null));
}

export interface Order {
  /** R or T, and how often the light met a surface: `3`, `16+`; without letter for all that are too few to be told apart. */
  readonly letter: string;
  readonly order: string;
  readonly value: number;
  readonly std: number | null;
}

/** Shares below this are told together. */
const TOLD_APART = 1e-3;

/** Energies by interactions in their order, the small ones of both sides in one (as if independent). */
export function ordersOf(byInteractions: Readonly<Record<string, Estimated>>): Order[] {
  const all = Object.entries(byInteractions)
    .map(([name, e]) => ({ letter: name.slice(0, 1), order: name.slice(1).replace('plus', '+'), ...e }))
    .filter((e) => e.value > 0)
    .sort((a, b) => a.letter.localeCompare(b.letter) || Number.parseInt(a.order) - Number.parseInt(b.order));
  const small = all.filter((e) => e.value < TOLD_APART);
  if (small.length < 2) return all;
  const rest = { letter: '', order: '', value: small.reduce((sum, e) => sum + e.value, 0), std: Math.hypot(...small.map((e) => e.std ?? 0)) };
  return [...all.filter((e) => e.value >= TOLD_APART), rest];
}
