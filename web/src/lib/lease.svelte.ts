// The lease of the rig: who holds it, and the lease of this page. Every request of the page renews it, and it ends soon after the page.

import { api, ownLease } from './api';
import { live } from './live.svelte';
import { session } from './session.svelte';
import type { Holder } from './types';

/** Shortest time between two requests for the holder, far below the term of a lease. */
const ASK_MS = 2500;

class LeaseState {
  holder = $state.raw<Holder | null>(null);
  /** Whether this page holds the rig by its lease. */
  own = $state(false);
  #asked = 0;
  /** The user who holds the rig by this page. */
  #user: string | null = null;

  /** Another caller that this user would disturb; null if there is none. */
  get other(): Holder | null {
    if (this.own || this.holder === null) return null;
    const isOwnScan = this.holder.until === null && this.holder.who === (session.user?.who ?? 'local');
    return isOwnScan ? null : this.holder;
  }

  /** Asks who holds the rig; `soon` leaves out a question that comes shortly after another. */
  async refresh(soon = false): Promise<void> {
    if (soon && Date.now() - this.#asked < ASK_MS) return;
    this.#asked = Date.now();
    const state = await api.lease().catch(() => null);
    if (state === null) return;
    const user = session.user?.who ?? 'local';
    // A press of Give back has forgotten it before; another user never had it.
    if (this.own && !state.own && ownLease.id() !== null && this.#user === user) {
      const { holder } = state;
      live.notify(holder === null ? 'The lease of this page has ended.' : `${holder.who === user ? 'Another page or program of yours' : holder.who} took the rig over from you.`);
    }
    this.holder = state.holder;
    this.own = state.own;
    this.#user = state.own ? user : null;
    if (!state.own) ownLease.forget();
  }

  async take(takeOver: boolean): Promise<void> {
    await live.attempt(async () => {
      const taken = await api.takeLease(`page of ${session.user?.who ?? 'local'}`, takeOver);
      ownLease.keep(taken.id);
    });
    await this.refresh();
  }

  async giveBack(): Promise<void> {
    await live.attempt(() => api.returnLease());
    ownLease.forget();
    await this.refresh();
  }
}

export const lease = new LeaseState();
