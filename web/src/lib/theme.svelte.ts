// Light or dark: the system's choice until a person chooses otherwise. `data-theme` on the root
// element carries the resolved choice, so that CSS and canvases read the same tokens.

import { flushSync } from 'svelte';

type Choice = 'light' | 'dark' | 'system';
const KEY = 'ridged-theme';

class Theme {
  choice = $state<Choice>('system');
  dark = $state(false);
  /** Canvases draw with the fonts loaded at that moment, so they draw again after the page's font is loaded. */
  fontReady = $state(false);

  start(): void {
    const kept = localStorage.getItem(KEY);
    if (kept === 'light' || kept === 'dark') this.choice = kept;
    const query = matchMedia('(prefers-color-scheme: dark)');
    const apply = (): void => this.#apply(query.matches);
    query.addEventListener('change', apply);
    apply();
    // Paper is white.
    addEventListener('beforeprint', () => this.#show(false));
    addEventListener('afterprint', apply);
    void Promise.all(['11px', '600 11px'].map((f) => document.fonts.load(`${f} "Inter Variable"`, '0θ'))).then(() => {
      this.fontReady = true;
    });
  }

  toggle(): void {
    this.choose(this.dark ? 'light' : 'dark');
  }

  choose(choice: Choice): void {
    this.choice = choice;
    if (choice === 'system') localStorage.removeItem(KEY);
    else localStorage.setItem(KEY, choice);
    this.#apply(matchMedia('(prefers-color-scheme: dark)').matches);
  }

  #apply(systemDark: boolean): void {
    this.#show(this.choice === 'system' ? systemDark : this.choice === 'dark');
  }

  #show(dark: boolean): void {
    document.documentElement.dataset['theme'] = dark ? 'dark' : 'light';
    this.dark = dark;
    // A print does not wait: canvases are drawn again at once.
    flushSync();
  }
}

export const theme = new Theme();

/** A token's value, for canvases. Reading `theme.dark` first makes the caller's effect run again on a change. */
export function token(name: string): string {
  void theme.dark;
  void theme.fontReady;
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}
