// Reads what a person types for a list of angles or exposures.

export type ListOutcome = { readonly ok: true; readonly values: number[] } | { readonly ok: false; readonly reason: string };

/** More values than this are a typing error. */
const VALUES_MAX = 2000;

/** A single comma between two digits may be a decimal mark or a separator. Several separate values, and so does one between tens:
 *  `20,60` would be a strange way to write 20.6. */
const isAmbiguous = (part: string): boolean => /\d,\d/.test(part) && part.split(',').filter((word) => word !== '').length === 2 && !/^[-+]?(\d*0),[-+]?(\d+0)$/.test(part);

/**
 * Numbers separated by blanks, semicolons or commas with a blank; `first:step:last` is a range with both ends.
 * `-20:10:20, 35` gives −20, −10, 0, 10, 20, 35. Repeated values are kept once. A number may have its unit, `°` or `ms`.
 */
export function parseList(typed: string, unit: '°' | 'ms' = '°'): ListOutcome {
  const values: number[] = [];
  const text = typed.replaceAll('−', '-').replace(unit === 'ms' ? /(?<=\d)\s*ms\b/g : /(?<=\d)\s*°/g, '');
  const words = text.split(/[\s,;]+/).filter((word) => word !== '');
  if (words.length === 0) return { ok: false, reason: 'Give at least one value.' };
  const either = text.split(/[\s;]+/).find(isAmbiguous);
  if (either !== undefined) return { ok: false, reason: `“${either}” is ambiguous. Write a decimal point, and a blank after a comma between values.` };
  for (const word of words) {
    const numbers = word.split(':').map((part) => (part === '' ? Number.NaN : Number(part)));
    const [first = Number.NaN, step = Number.NaN, last = Number.NaN] = numbers;
    if (numbers.some((n) => !Number.isFinite(n)) || (numbers.length !== 1 && numbers.length !== 3)) {
      return { ok: false, reason: `Expected a number or a range first:step:last, got “${word}”.` };
    }
    if (numbers.length === 1) {
      values.push(first);
      continue;
    }
    if (step === 0 && last !== first) return { ok: false, reason: `The range ${word} has a step of 0.` };
    const steps = last === first ? 0 : (last - first) / step;
    if (!(steps >= 0)) return { ok: false, reason: `The range ${word} does not reach ${last} from ${first}.` };
    const whole = Math.round(steps);
    if (Math.abs(steps - whole) > 1e-6 * Math.max(1, steps)) {
      return { ok: false, reason: `The range ${word} does not end at ${last}: write first:step:last, for example ${first}:${step}:${Number((first + Math.floor(steps) * step).toPrecision(12))}.` };
    }
    if (steps > VALUES_MAX) return { ok: false, reason: `The range ${word} has more than ${VALUES_MAX} values.` };
    // A count, not a running sum: 0.1 added ten times is not 1.
    for (let i = 0; i <= whole; i++) values.push(Number((first + i * step).toPrecision(12)));
  }
  return { ok: true, values: [...new Set(values)] };
}

/** The shortest text that `parseList` reads back; a range if the steps are even. */
export function printList(values: readonly number[]): string {
  const [first = 0, second = 0] = values;
  const step = Number((second - first).toPrecision(12));
  const even = values.length > 2 && values.every((v, i) => Math.abs(v - (first + i * step)) < 1e-9 * Math.max(1, Math.abs(v)));
  return even ? `${first}:${step}:${values[values.length - 1]}` : values.join(', ');
}

/** The values as text: `2 exposures: 2 ms, 5 ms`; for many values the first ones and the last. */
export function readWords(values: readonly number[], noun: string, print: (x: number) => string): string {
  const named = values.length <= LISTED ? values.map(print).join(', ') : `${values.slice(0, LISTED - 2).map(print).join(', ')} … ${print(values.at(-1) ?? 0)}`;
  return `${values.length} ${noun}${values.length === 1 ? '' : 's'}: ${named}`;
}

/** Values that fit on one line. */
const LISTED = 6;
