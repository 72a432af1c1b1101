// Keyboard focus in small forms: a button that is replaced by its form, and a form that closes, would leave it at the start of the page.

const FIELDS = 'input:not([type=hidden], [type=checkbox], [type=radio]):enabled, select:enabled, textarea:enabled';
const BUTTONS = 'button:enabled, a[href], summary';
const MARK = 'data-keeps-focus';
/** Longest time from a press to the form that it opens. */
const OPENS_MS = 1000;

/** What a control is called, to find it again after it was made again. */
const nameOf = (of: HTMLElement): string => of.getAttribute('aria-label') ?? of.textContent?.trim() ?? '';

/**
 * Keeps the focus of an element around a small form, as an effect (`bind:this`): an action would add to the first view. It moves from the button that opens the form to its first field, with its
 * text selected, and back when the form closes. A button that only shows more (`aria-expanded`) keeps it. A control that is disabled
 * for a while has the focus again afterwards. Nothing is taken from another control.
 */
export function keepFocus(whole: HTMLElement | undefined): (() => void) | undefined {
  if (!whole) return undefined;
  const node = whole;
  node.setAttribute(MARK, '');
  /** The control that has the focus, or had it until it went. */
  let last: HTMLElement | null = null;
  /** Its ancestors up to `node`, nearest first. */
  let around: HTMLElement[] = [];
  let opener: HTMLElement | null = null;
  let pressedAt = 0;

  const isUsable = (control: HTMLElement): boolean => control.isConnected && !control.matches(':disabled');
  const isLost = (): boolean => {
    const now = document.activeElement;
    return now === null || now === document.body || (now === last && !isUsable(last));
  };
  function focus(control: HTMLElement): void {
    control.focus();
    if (control instanceof HTMLInputElement) control.select();
  }
  function again(control: HTMLElement): HTMLElement | null {
    if (isUsable(control) && node.contains(control)) return control;
    return [...node.querySelectorAll<HTMLElement>(BUTTONS)].find((one) => one.tagName === control.tagName && nameOf(one) === nameOf(control)) ?? null;
  }

  const entered = ({ target }: FocusEvent): void => {
    if (!(target instanceof HTMLElement)) return;
    // A part with a form of its own keeps it itself.
    last = target.closest(`[${MARK}]`) === node ? target : null;
    around = [];
    for (let at = last?.parentElement; at && node.contains(at); at = at.parentElement) around.push(at);
  };
  const left = ({ target }: FocusEvent): void => {
    const from = target as HTMLElement;
    // A control that is being removed or disabled loses the focus, too; one that a person left does not take it back.
    queueMicrotask(() => {
      if (last === from && isUsable(from) && document.activeElement !== from) last = null;
    });
  };

  const observer = new MutationObserver((changes) => {
    if (last === null) return;
    const lost = last;
    const opens = document.activeElement === lost && lost.matches('button') && Date.now() - pressedAt < OPENS_MS;
    if (!opens && !isLost()) return;
    const added = changes.flatMap((change) => [...change.addedNodes]).filter((one): one is HTMLElement => one instanceof HTMLElement && one.isConnected);
    const find = (selector: string): HTMLElement[] => added.flatMap((one) => [...(one.matches(selector) ? [one] : []), ...one.querySelectorAll<HTMLElement>(selector)]);
    const [field] = find(FIELDS);
    if (field) {
      opener = lost;
      if (!lost.matches('[aria-expanded]:enabled')) focus(field);
      return;
    }
    if (!isLost()) return;
    // Disabled while it works: it comes back. Enabled again: here it is.
    if (lost.isConnected) {
      if (isUsable(lost)) lost.focus({ preventScroll: true });
      return;
    }
    const back = opener === null ? null : again(opener);
    if (back) {
      opener = null;
      return focus(back);
    }
    // Of buttons that came instead, the last one is the harmless one.
    const came = find(BUTTONS).at(-1);
    if (came) opener = lost;
    const near = came ?? around.find((one) => one.isConnected)?.querySelector<HTMLElement>(`${BUTTONS}, ${FIELDS}`);
    if (near) focus(near);
  });
  const pressed = (): void => {
    pressedAt = Date.now();
  };
  observer.observe(node, { childList: true, subtree: true, attributes: true, attributeFilter: ['disabled'] });
  node.addEventListener('click', pressed);
  node.addEventListener('focusin', entered);
  node.addEventListener('focusout', left);

  return () => {
    observer.disconnect();
    if (last === null) return;
    // The whole part goes with its focus.
    queueMicrotask(() => {
      if (document.activeElement === null || document.activeElement === document.body) document.getElementById('main')?.focus({ preventScroll: true });
    });
  };
}
