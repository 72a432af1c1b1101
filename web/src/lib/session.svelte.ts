// Who uses the page. A daemon that asks for a token answers 401 until a login; then the cookie stands for the token.

import { api, whenLoginIsNeeded } from './api';
import { Problem } from './problems';
import type { Session } from './types';

const RANKS: Readonly<Record<Session['role'], number>> = { viewer: 0, analyst: 1, operator: 2, admin: 3 };

class SessionState {
  /** Null until the daemon has answered. */
  user = $state.raw<Session | null>(null);
  loginNeeded = $state(false);
  /** Whether a login that was valid is not any more, without a log-out. */
  ended = $state(false);
  /** True once the daemon was asked, whatever it answered. */
  asked = $state(false);
  #leaving = false;

  start(): void {
    whenLoginIsNeeded((code) => {
      // A cookie that is refused was valid once.
      if (!this.#leaving && (this.user !== null || (!this.loginNeeded && code === 'wrong-token'))) this.ended = true;
      this.user = null;
      this.loginNeeded = true;
    });
    void this.#ask();
  }

  /** Whether the user may do what needs this role. An unknown user may try: the daemon decides. */
  may(role: Session['role']): boolean {
    return this.user === null || RANKS[this.user.role] >= RANKS[role];
  }

  /** Throws what the daemon refuses. */
  async login(token: string): Promise<void> {
    this.user = await api.login(token);
    this.ended = false;
    this.loginNeeded = false;
  }

  async logout(): Promise<void> {
    this.#leaving = true;
    await api.logout().catch(() => undefined);
    await this.#ask();
    this.#leaving = false;
  }

  /** Whether requests have an answer: the daemon was asked who uses the page, and needs no login. */
  get open(): boolean {
    return this.asked && !this.loginNeeded;
  }

  async #ask(): Promise<void> {
    try {
      this.user = await api.session();
      this.loginNeeded = false;
    } catch (error) {
      // A daemon that does not answer is reported by the page itself.
      if (error instanceof Problem && error.status === 401) this.loginNeeded = true;
    }
    this.asked = true;
  }
}

export const session = new SessionState();
