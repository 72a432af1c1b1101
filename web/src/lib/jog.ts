// A jog that lasts while a button is held. The daemon stops the axis 0.5 s after the last renewal, so that it also stops when
// this page or its machine is gone.

import { api } from './api';
import type { AxisName } from './types';

const RENEW_MS = 150;

export interface HeldJog {
  /** Ends the jog. */
  readonly release: () => void;
  /** Fulfilled once the axis has stopped; rejected if the daemon refused or ended the jog. */
  readonly done: Promise<void>;
}

/** Begins to move an axis. `atEnd` gets the reason why it waits at a limit or a forbidden region, and null while it moves. */
export function hold(axis: AxisName, speed_deg_s: number, atEnd: (why: string | null) => void): HeldJog {
  let held = true;
  let wake = (): void => undefined;
  const release = (): void => {
    held = false;
    wake();
  };
  const pause = (): Promise<void> =>
    new Promise((resolve) => {
      const timer = setTimeout(resolve, RENEW_MS);
      wake = () => {
        clearTimeout(timer);
        resolve();
      };
    });
  const run = async (): Promise<void> => {
    const begun = await api.jog({ axis, speed_deg_s });
    atEnd(begun.at_end);
    for (;;) {
      if (held) await pause();
      if (!held) break;
      atEnd((await api.jog({ axis, speed_deg_s, jog: begun.jog })).at_end);
    }
    await api.jog({ axis, speed_deg_s: 0, jog: begun.jog });
  };
  return { release, done: run() };
}
