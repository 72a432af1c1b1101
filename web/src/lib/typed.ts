// Numbers as people type them.

/** A typed number; a decimal comma is accepted. Null if empty, NaN if it is not a number. */
export function typed(text: string): number | null {
  const trimmed = text.trim().replace('−', '-').replace(',', '.');
  if (trimmed === '') return null;
  return /^[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$/i.test(trimmed) ? Number(trimmed) : Number.NaN;
}
