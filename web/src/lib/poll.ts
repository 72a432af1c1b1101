// What the daemon works on, asked for until none of it runs.

/** While one runs it is asked how far it is, this often. */
const POLL_MS = 500;

/**
 * Asks for rows and hands each answer on; asks again while one of them runs. The function it returns ends that:
 * no answer is handed on after it. A question that fails is the last: whoever calls asks anew at the next event,
 * and a daemon that does not answer is told of elsewhere.
 */
export function whileRunning<Row extends { readonly state: string }>(ask: (signal: AbortSignal) => Promise<readonly Row[]>, take: (rows: readonly Row[]) => void): () => void {
  const abort = new AbortController();
  let timer: ReturnType<typeof setTimeout> | undefined;
  const once = async (): Promise<void> => {
    try {
      const rows = await ask(abort.signal);
      if (abort.signal.aborted) return;
      take(rows);
      if (rows.some((row) => row.state === 'running')) timer = setTimeout(() => void once(), POLL_MS);
    } catch {
      // The next event asks again.
    }
  };
  void once();
  return () => {
    abort.abort();
    clearTimeout(timer);
  };
}
