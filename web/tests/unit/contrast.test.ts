import { readFileSync } from 'node:fs';
import { join } from 'node:path';

import { describe, expect, it } from 'vitest';

/** The colours of the page, and those of the budgets, which come with the first budget. */
const CSS = ['app.css', 'parts/BudgetBar.svelte'].map((name) => readFileSync(join(import.meta.dirname, '../../src', name), 'utf8')).join('\n').replace(/:global\((.+?)\)/g, '$1');

/** Tokens of one theme; those of the dark one override the light ones. */
function tokens(selector: string): Map<string, string> {
  const body = CSS.split(`${selector} {`).slice(1).map((rest) => rest.split('}')[0]).join('\n');
  return new Map([...body.matchAll(/--([\w-]+):\s*(#[0-9a-f]{6}|var\(--[\w-]+\))/g)].map(([, name = '', value = '']) => [name, value]));
}

/** Relative luminance (WCAG 2.2). */
function luminance(hex: string): number {
  const [r = 0, g = 0, b = 0] = [1, 3, 5].map((i) => Number.parseInt(hex.slice(i, i + 2), 16) / 255).map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
}

function contrast(a: string, b: string): number {
  const [light = 0, dark = 0] = [luminance(a), luminance(b)].sort((x, y) => y - x);
  return (light + 0.05) / (dark + 0.05);
}

const TEXT_ON: [string, string[]][] = [
  ['text', ['ground', 'surface', 'sunken', 'accent-soft', 'warn-soft', 'bad-soft']],
  ['muted', ['ground', 'surface', 'sunken', 'accent-soft', 'warn-soft', 'bad-soft']],
  ['faint', ['surface']],
  ['accent', ['surface', 'accent-soft']],
  ['good', ['surface', 'good-soft']],
  ['warn', ['surface', 'warn-soft']],
  ['bad', ['surface', 'bad-soft']],
  ['on-accent', ['accent']],
];
const MARKS = ['curve-sawtooth', 'curve-paper', 'curve-traced', 'budget-model', 'budget-reference'];

describe.each([':root', ":root[data-theme='dark']"])('colours of %s', (selector) => {
  const theme = new Map([...tokens(':root'), ...tokens(selector)]);
  const of = (name: string): string => {
    const value = theme.get(name);
    if (value === undefined) throw new Error(`no token --${name}`);
    const other = /^var\(--(.+)\)$/.exec(value)?.[1];
    return other === undefined ? value : of(other);
  };

  it('text has a contrast of at least 4.5 : 1', () => {
    const poor = TEXT_ON.flatMap(([text, grounds]) =>
      grounds.map((ground) => ({ text, ground, ratio: contrast(of(text), of(ground)) })).filter(({ ratio }) => ratio < 4.5),
    );
    expect(poor).toEqual([]);
    expect(contrast('#ffffff', of('stop'))).toBeGreaterThan(4.5);
  });

  it('curves and bars have a contrast of at least 3 : 1', () => {
    expect(MARKS.filter((name) => contrast(of(name), of('surface')) < 3)).toEqual([]);
  });
});
