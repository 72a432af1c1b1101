// What the form of the next part holds. It is kept during a scan, when there is no form, since the next part is often like the last.
// The browser remembers the recipe, the specification and the operator's name.

import { newGrid, gridOf, type GridDraft } from './plan';
import type { Scan } from './types';

const KEY = 'ridged-next-part';
/** Instead of a recipe: poses and exposures of the form. */
export const OWN_GRID = '';

interface Remembered {
  readonly recipe: string | null;
  readonly specification: string;
  readonly operator: string;
}

function remembered(): Remembered {
  const none: Remembered = { recipe: null, specification: '', operator: '' };
  try {
    return { ...none, ...(JSON.parse(localStorage.getItem(KEY) ?? '{}') as Partial<Remembered>) };
  } catch {
    return none;
  }
}

class NextPart {
  /** Null: the last scanned part; `ask`: a person has to choose. */
  sample = $state<number | 'new' | 'ask' | null>(null);
  /** Name of the recipe; null before a choice. */
  recipe = $state<string | null>(null);
  /** Name of the specification; empty for none. */
  specification = $state('');
  lot = $state('');
  externalId = $state('');
  operator = $state('');
  /** Of this part only. */
  note = $state('');
  grid = $state<GridDraft>(newGrid());

  constructor() {
    ({ recipe: this.recipe, specification: this.specification, operator: this.operator } = remembered());
  }

  /** The recipe that is chosen, as far as it exists; the only one without a choice. */
  recipeAmong(recipes: readonly { readonly name: string }[]): string | null {
    if (recipes.length === 0 || this.recipe === OWN_GRID) return OWN_GRID;
    return recipes.find((r) => r.name === this.recipe)?.name ?? (recipes.length === 1 ? recipes[0]?.name : null) ?? null;
  }

  /** Keeps what the next part will probably share; an external number belongs to one part only. */
  sent(): void {
    [this.externalId, this.note] = ['', ''];
    const kept: Remembered = { recipe: this.recipe === OWN_GRID ? remembered().recipe : this.recipe, specification: this.specification, operator: this.operator.trim() };
    try {
      localStorage.setItem(KEY, JSON.stringify(kept));
    } catch {
      // A browser that keeps nothing asks again.
    }
  }

  /** Fills the form for another scan of the same part. */
  repeat(scan: Scan, recipes: readonly string[]): void {
    this.sample = scan.sample_id;
    this.recipe = scan.recipe && recipes.includes(scan.recipe.name) ? scan.recipe.name : OWN_GRID;
    this.specification = scan.specification?.name ?? '';
    this.lot = scan.lot ?? '';
    this.externalId = scan.external_id ?? '';
    if (this.recipe === OWN_GRID) this.grid = gridOf({ ...scan.plan, repeats: Math.max(1, scan.plan.repeats) });
  }
}

export const next = new NextPart();
