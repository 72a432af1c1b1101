// Polls running work of the daemon until none of it runs.

/** Interval of the polls while work is running. */
const POLL_MS = 500;

/**
 * Reads rows and passes each answer on, repeatedly while one of them runs. The returned function ends the polling;
 * no answer is passed on after it. A failed request ends the polling too, and `failed` gets its cause: the caller starts
 * again at the next event, when the link is live again, or when the user asks for it.
 */
export function whileRunning<Row extends { readonly state: string }>(ask: (signal: AbortSignal) => Promise<readonly Row[]>, take: (rows: readonly Row[]) => void, failed: (error: unknown) => void): () => void {
  const abort = new AbortController();
  let timer: ReturnType<typeof setTimeout> | undefined;
  const once = async (): Promise<void> => {
    try {
      const rows = await ask(abort.signal);
      if (abort.signal.aborted) return;
      take(rows);
      if (rows.some((row) => row.state === 'running')) timer = setTimeout(() => void once(), POLL_MS);
    } catch (error) {
      if (!abort.signal.aborted) failed(error);
    }
  };
  void once();
  return () => {
    abort.abort();
    clearTimeout(timer);
  };
}
