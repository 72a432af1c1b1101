// Numbers, times and sizes as people read them in a laboratory.

const MINUS = '−';
/** Narrow no-break space between number and unit and in groups of digits. */
const THIN = '\u202f';

/** `x.toFixed(decimals)` with a true minus sign and never a negative zero. */
export function fixed(x: number, decimals: number): string {
  const text = x.toFixed(decimals);
  if (Number(text) === 0) return text.replace('-', '');
  return text.replace('-', MINUS);
}

/** Decimals that show an uncertainty with two significant digits; at least 0, at most 9. */
export function decimalsFor(uncertainty: number): number {
  if (!Number.isFinite(uncertainty) || uncertainty <= 0) return 4;
  // 0.0996 rounds to 0.10, one digit less than its logarithm suggests.
  const digits = 1 - Math.floor(Math.log10(Number(uncertainty.toPrecision(2))));
  return Math.min(9, Math.max(0, digits));
}

/** Decimals that write every multiple of a step exactly: 0.025 needs three. */
export function decimalsOfStep(step: number): number {
  const whole = (x: number): boolean => Math.abs(x - Math.round(x)) < 1e-6 * Math.max(1, Math.abs(x)) && Math.round(x) !== 0;
  for (let decimals = 0; decimals < 9; decimals++) if (whole(Math.abs(step) * 10 ** decimals)) return decimals;
  return 9;
}

/** Value and uncertainty rounded to the same place, the uncertainty to two significant digits. */
export function withUncertainty(value: number, uncertainty: number): { value: string; uncertainty: string } {
  const decimals = decimalsFor(uncertainty);
  return { value: fixed(value, decimals), uncertainty: fixed(uncertainty, decimals) };
}

/** The decimals that a written number lacks: `00`, `.00`. Shown invisibly at its end, they align the decimal points of a column. */
export function decimalsMissing(text: string, decimals: number): string {
  const [, own] = text.split('.');
  return own === undefined ? (decimals > 0 ? `.${'0'.repeat(decimals)}` : '') : '0'.repeat(Math.max(0, decimals - own.length));
}

/** Decimals of a number that is written out. */
export const decimalsOf = (text: string): number => text.split('.')[1]?.length ?? 0;

/** Few significant digits, exponents as powers of ten: `3.2 × 10⁻⁵`. */
export function significant(x: number, digits = 2): string {
  if (x === 0) return '0';
  const exponent = Math.floor(Math.log10(Math.abs(Number(x.toPrecision(digits)))));
  if (exponent >= -4 && exponent < 6) return fixed(x, Math.max(0, digits - 1 - exponent));
  const mantissa = fixed(x / 10 ** exponent, digits - 1);
  return `${mantissa}${THIN}×${THIN}10${superscript(exponent)}`;
}

/** Up to `digits` significant digits without trailing zeros: `12.5`, `550`. */
export function plain(x: number, digits = 3): string {
  return String(Number(x.toPrecision(digits))).replace('-', MINUS);
}

/** A value that was held, as it was typed: `12° (fixed)`. */
export const heldWords = (value: number, unit = ''): string => `${plain(value, 12)}${unit} (fixed)`;

/** The coverage factors of expanded uncertainties in words: `k = 2`, and `k = 2 … 4.53` if they differ. */
export function coverageWords(factors: readonly (number | null | undefined)[]): string {
  const [least = '2', ...others] = [...new Set(factors.filter((k) => k != null).sort((a, b) => a - b).map((k) => plain(k)))];
  return `k = ${[least, ...others.slice(-1)].join(' … ')}`;
}

/** A tick of a logarithmic axis: `10⁻⁷`, `5 × 10⁻⁷`. */
export function decade(x: number): string {
  const exponent = Math.floor(Math.log10(Number(x.toPrecision(1))));
  const digit = Number((x / 10 ** exponent).toPrecision(1));
  return `${digit === 1 ? '' : `${digit}${THIN}×${THIN}`}10${superscript(exponent)}`;
}

function superscript(n: number): string {
  return String(n).replace(/[-\d]/g, (c) => (c === '-' ? '⁻' : ('⁰¹²³⁴⁵⁶⁷⁸⁹'[Number(c)] ?? '')));
}

/** A fraction as a percentage with two significant digits: `0.61 %`. */
export function percent(fraction: number): string {
  return `${significant(fraction * 100)}${THIN}%`;
}

/** Whole numbers in groups of three: `65 535`. */
export function count(n: number): string {
  return fixed(Math.round(n), 0).replace(/\B(?=(\d{3})+$)/g, THIN);
}

/** A count and its noun: `1 tilt`, `12 tilts`. */
export function counted(n: number, noun: string): string {
  return `${count(n)} ${noun}${n === 1 ? '' : 's'}`;
}

/** `8 s`, `4 min 20 s`, `2 h 05 min`. */
export function duration(seconds: number): string {
  const s = Math.max(0, Math.round(seconds));
  if (s < 60) return `${s} s`;
  if (s < 3600) return `${Math.floor(s / 60)} min ${String(s % 60).padStart(2, '0')} s`;
  return `${Math.floor(s / 3600)} h ${String(Math.floor((s % 3600) / 60)).padStart(2, '0')} min`;
}

/** Time left of running work: `, 12 s left`; empty while it is not known. */
export function timeLeft(progress: { readonly fraction: number; readonly elapsed_s: number; readonly time_left_s: number | null } | null | undefined): string {
  // The pace is not known at the start of a stage, and the last half second is not worth showing.
  if (progress?.time_left_s == null || progress.fraction <= 0 || progress.elapsed_s < 0.5 || progress.time_left_s < 0.5) return '';
  return `, ${duration(progress.time_left_s)} left`;
}

/** The two ends of a range with enough decimals to distinguish them: `9.976 … 10.020`. */
export function between(low: number, high: number): readonly [string, string] {
  const decimals = Math.min(9, decimalsFor(Math.max((high - low) / 3, 1e-3 * Math.max(Math.abs(low), Math.abs(high)))));
  return [fixed(low, decimals), fixed(high, decimals)];
}

/** Measured seconds: `0.34 s`, and from 10 s on as `duration` formats them. */
export function seconds(s: number): string {
  return s < 10 ? `${significant(Math.max(s, 0.01))} s` : duration(s);
}

/** Bytes in decimal units: `2.6 MB`. */
export function bytes(n: number): string {
  const units = ['B', 'kB', 'MB', 'GB', 'TB'];
  let value = n;
  let unit = 0;
  while (value >= 999.5 && unit < units.length - 1) {
    value /= 1000;
    unit += 1;
  }
  const text = unit === 0 || value >= 99.95 ? value.toFixed(0) : value.toFixed(1);
  return `${text} ${units[unit]}`;
}

/** Milliseconds below 0.1 s, else up to four significant digits: `20 ms`, `0.18 s`. */
export function exposure(seconds: number): string {
  if (seconds < 0.1) return `${Number((seconds * 1000).toPrecision(4))} ms`;
  return `${Number(seconds.toPrecision(4))} s`;
}

/** An angle without trailing zeros: `−20°`, `12.5°`. */
export function angle(deg: number, decimalsMax = 3): string {
  const text = fixed(deg, decimalsMax);
  return `${text.includes('.') ? text.replace(/\.?0+$/, '') : text}°`;
}

/** Local date and time to the second with the offset from UTC: `2026-01-02 17:34:05 +01:00`. */
export function moment(iso: string | null | undefined): string {
  if (!iso) return '';
  const t = new Date(iso);
  if (Number.isNaN(t.getTime())) return iso;
  const two = (n: number): string => String(Math.floor(n)).padStart(2, '0');
  const offset = -t.getTimezoneOffset();
  const zone = `${offset < 0 ? MINUS : '+'}${two(Math.abs(offset) / 60)}:${two(Math.abs(offset) % 60)}`;
  return `${t.getFullYear()}-${two(t.getMonth() + 1)}-${two(t.getDate())} ${two(t.getHours())}:${two(t.getMinutes())}:${two(t.getSeconds())} ${zone}`;
}

/** Local date and time to the minute in ISO order, without the date if it is today. */
export function when(iso: string | null | undefined, now = new Date()): string {
  if (!iso) return '';
  const t = new Date(iso);
  if (Number.isNaN(t.getTime())) return iso;
  const two = (n: number): string => String(n).padStart(2, '0');
  const clock = `${two(t.getHours())}:${two(t.getMinutes())}`;
  if (t.toDateString() === now.toDateString()) return clock;
  return `${t.getFullYear()}-${two(t.getMonth() + 1)}-${two(t.getDate())} ${clock}`;
}
