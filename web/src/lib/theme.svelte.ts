// Light or dark: the system's choice until a person chooses otherwise. `data-theme` on the root
// element carries the resolved choice, so that CSS and canvases read the same tokens.

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
    void Promise.all(['11px', '600 11px'].map((f) => document.fonts.load(`${f} "Inter Variable"`, '0θ'))).then(() => {
      this.fontReady = true;
    });
  }

  toggle(): void {
    this.choice = this.dark ? 'light' : 'dark';
    localStorage.setItem(KEY, this.choice);
    this.#apply(this.dark);
  }

  #apply(systemDark: boolean): void {
    this.dark = this.choice === 'system' ? systemDark : this.choice === 'dark';
    document.documentElement.dataset['theme'] = this.dark ? 'dark' : 'light';
  }
}

export const theme = new Theme();

/** A token's value, for canvases. Reading `theme.dark` first makes the caller's effect run again on a change. */
export function token(name: string): string {
  void theme.dark;
  void theme.fontReady;
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}
