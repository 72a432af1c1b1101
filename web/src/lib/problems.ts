// What the daemon refuses, in the words of the page: by the problem's code and the fields that it names. A message of the
// daemon is shown as it is; the page adds what its own form calls the field and what to do there.

import { plain, when } from './format';
import type { Holder } from './types';
import { KNOWABLE } from './words';

/** Names of the axes in messages of the daemon, outside paths and longer names. */
const AXES = /(?<![\w./])(theta_c|phi_s)(?![\w/]|\.\w)/g;

/** A text with the symbols of the axes, as the page writes them. */
export const withSymbols = (text: string): string => text.replace(AXES, (name) => (name === 'theta_c' ? 'θc' : 'φs'));

/** What is wrong with one value of a request. */
export interface FieldProblem {
  /** Path of the value: `plan.theta_c_deg[2]`. */
  readonly field: string;
  readonly message: string;
  /** In the unit of the field. */
  readonly out_of_range?: { readonly value: number; readonly lower: number; readonly upper: number };
}

/** A refused or failed request. `message` is for people, `code` for programs. */
export class Problem extends Error {
  readonly status: number;
  readonly code: string;
  readonly errors: readonly FieldProblem[];

  constructor(status: number, code: string, message: string, errors: readonly FieldProblem[] = []) {
    super(message);
    this.status = status;
    this.code = code;
    this.errors = errors;
  }
}

interface FieldWords {
  readonly name: string;
  readonly unit?: string;
  /** From the unit of the request to that of the form. */
  readonly factor?: number;
}

const TILT: FieldWords = { name: 'Camera tilt', unit: '°' };
const AZIMUTH: FieldWords = { name: 'Sample azimuth', unit: '°' };
const EXPOSURE: FieldWords = { name: 'Exposure', unit: ' ms', factor: 1000 };

/** Fields of plans and moves as the forms call them. */
const FIELDS: Readonly<Record<string, FieldWords>> = {
  theta_c_deg: TILT,
  phi_s_deg: AZIMUTH,
  position_deg: { name: 'Position', unit: '°' },
  poses: { name: 'Poses' },
  'poses.theta_c_deg': TILT,
  'poses.phi_s_deg': AZIMUTH,
  exposures_s: EXPOSURE,
  repeats: { name: 'Repeats' },
  'dark.repeats': { name: 'Dark frames, repeats' },
  'flat.theta_c_deg': { ...TILT, name: 'White reference, camera tilt' },
  'flat.exposures_s': { ...EXPOSURE, name: 'White reference, exposure' },
  'flat.repeats': { name: 'White reference, repeats' },
  folder: { name: 'Folder' },
  scene: { name: 'Scene' },
  shape: { name: 'Shape' },
};

/** What to do about a problem on this page. */
const HINTS: Readonly<Record<string, string>> = {
  'frame-unreadable': 'To import the other frames, tick “leave out frames that cannot be read”.',
};

/** Problems that the page states in its own words. */
const INSTEAD: Readonly<Record<string, string>> = {
  'lease-lost': 'This page does not hold the rig any more. Give the order again, or hold the rig again in the view Rig.',
};

/** A first word of letters only. Files, paths, keys and symbols keep their case. */
const PLAIN_WORD = /^[a-z]+(?:[-’'][a-z]+)*[,:;.!?…]*(?=\s|$)/;

/** First letter large, a full stop at the end. */
export function sentence(text: string): string {
  const trimmed = text.trim();
  if (trimmed === '') return '';
  const head = PLAIN_WORD.test(trimmed) ? trimmed.charAt(0).toUpperCase() + trimmed.slice(1) : trimmed;
  return /[.!?…]$/.test(head) ? head : `${head}.`;
}

/** The path without the places in lists. */
const stem = (field: string): string => field.replace(/\[\d+\]/g, '');

function fieldWords(path: string): FieldWords | null {
  const [list, parameter] = path.split('.');
  const known = (list === 'fix' || list === 'priors') && parameter !== undefined ? KNOWABLE[parameter] : undefined;
  return FIELDS[path.replace('plan.', '')] ?? (known ? { name: known.name } : null);
}

/** Wrong values in sentences. Values with the same range are put into one. */
export function faultWords(errors: readonly FieldProblem[]): string {
  const parts: string[] = [];
  const ranges = new Map<string, { values: string[]; words: FieldWords; range: string }>();
  for (const { field, message, out_of_range } of errors) {
    const path = stem(field);
    const words = fieldWords(path);
    if (out_of_range && words) {
      const show = (x: number): string => plain(x * (words.factor ?? 1), 6);
      const range = `${show(out_of_range.lower)} to ${show(out_of_range.upper)}${words.unit ?? ''}`;
      const same = ranges.get(`${path} ${range}`);
      const value = `${show(out_of_range.value)}${words.unit ?? ''}`;
      if (same) same.values.push(value);
      else ranges.set(`${path} ${range}`, { values: [value], words, range });
      if (!same) parts.push(`${path} ${range}`);
    } else {
      parts.push(sentence(`${words?.name ?? field}: ${message}`));
    }
  }
  const all = parts.map((part) => {
    const range = ranges.get(part);
    return range ? `${range.words.name}: ${range.values.join(', ')} ${range.values.length === 1 ? 'is' : 'are'} outside ${range.range}.` : part;
  });
  return [...new Set(all)].join(' ');
}

/** What follows the name of the holder of the rig: `holds the rig: night run, until 15:03 or longer.` */
export const holdsWords = ({ name, until }: Holder): string => `holds the rig: ${name}${until === null ? ', until its end' : `, until ${when(until)} or longer`}.`;

/** What a problem+json body (RFC 9457) says; `fallback` where it says nothing. */
export function problemOf(status: number, body: unknown, fallback: string): Problem {
  const { title, detail, code, errors, holder } = (typeof body === 'object' && body !== null ? body : {}) as Readonly<Record<string, unknown>>;
  const named = Array.isArray(errors) ? (errors as readonly FieldProblem[]) : [];
  const text = (value: unknown): string => (typeof value === 'string' ? value : '');
  const word = text(code) || `http-${status}`;
  const message = INSTEAD[word] ?? (named.length > 0 ? faultWords(named) : sentence(text(detail) || text(title) || fallback));
  if (word === 'lease-held' && typeof holder === 'object' && holder !== null) {
    const other = holder as Holder;
    return new Problem(status, word, `${other.who} ${holdsWords(other)} Wait, or take the rig over in the view Rig.`);
  }
  const hint = HINTS[word];
  return new Problem(status, word, hint === undefined ? message : `${message} ${hint}`, named);
}

export const noAnswer = (): Problem => new Problem(0, 'no-answer', 'The daemon does not answer. Is “ridged serve” still running?');

/** The sentence to show for anything that was thrown. */
export function spoken(error: unknown): string {
  return error instanceof Error ? error.message : sentence(String(error));
}
