// Helpers for elements. Texts from users are never parsed as markup. `keyed` updates a list and keeps unchanged rows.

type Child = Node | string | null | undefined | false;
interface Props {
  class?: string;
  test?: string; // value of data-test, by which tests find the element
  text?: string | number;
  on?: { [K in keyof HTMLElementEventMap]?: (event: HTMLElementEventMap[K]) => void };
  [attribute: string]: unknown;
}

/** Return an element with attributes. `true` gives an empty attribute; `false`, null and undefined give none. */
export function el<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  props: Props = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(props)) {
    if (value === null || value === undefined || value === false) continue;
    if (name === "class") element.className = String(value);
    else if (name === "text") element.textContent = String(value);
    else if (name === "test") element.dataset.test = String(value);
    else if (name === "on") listen(element, value as NonNullable<Props["on"]>);
    else element.setAttribute(name, value === true ? "" : String(value));
  }
  element.append(...(children.filter(Boolean) as (Node | string)[]));
  return element;
}

function listen(element: HTMLElement, on: NonNullable<Props["on"]>): void {
  for (const [event, listener] of Object.entries(on)) element.addEventListener(event, listener as EventListener);
}

/** Return a button with a text. If the text is a symbol, pass an `aria-label` too. */
export function button(words: string, pressed: () => void, props: Props = {}): HTMLButtonElement {
  return el("button", { type: "button", text: words, ...props, on: { click: pressed } });
}

export function svg<K extends keyof SVGElementTagNameMap>(
  tag: K,
  props: Record<string, string | number> = {},
): SVGElementTagNameMap[K] {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(props)) element.setAttribute(name, String(value));
  return element;
}

/** Set the text of an element if it differs: screen readers announce each text only once. */
export function setText(element: Element, words: string): void {
  if (element.textContent !== words) element.textContent = words;
}

export interface Row<T> {
  element: Element;
  update: (item: T) => void;
}

/** Return a function that displays a list. Each key has one row, which is created once and then updated in place. */
export function keyed<T>(place: Element, key: (item: T) => string, make: (item: T) => Row<T>): (items: readonly T[]) => void {
  const rows = new Map<string, Row<T>>();
  return (items) => {
    const keys = new Set(items.map(key));
    for (const [name, row] of rows) {
      if (keys.has(name)) continue;
      row.element.remove();
      rows.delete(name);
    }
    let before: Element | null = null;
    for (const item of items) {
      const row = rows.get(key(item)) ?? make(item);
      rows.set(key(item), row);
      row.update(item);
      const expected: Element | null = before ? before.nextElementSibling : place.firstElementChild;
      if (row.element !== expected) place.insertBefore(row.element, expected);
      before = row.element;
    }
  };
}

/** Limit a function to one call in `wait` ms. The last arguments are always passed on, if necessary later. */
export function throttled<A extends unknown[]>(wait: number, act: (...args: A) => void): (...args: A) => void {
  let last = Number.NEGATIVE_INFINITY;
  let waiting: A | null = null;
  const go = () => {
    if (!waiting) return;
    const args = waiting;
    waiting = null;
    last = performance.now();
    act(...args);
  };
  return (...args) => {
    const free = last + wait - performance.now();
    if (!waiting && free > 0) setTimeout(go, free);
    const idle = !waiting && free <= 0;
    waiting = args;
    if (idle) go();
  };
}

/** Run a function before the next repaint, once even after several requests. */
export function oncePerRepaint(act: () => void): () => void {
  let isRequested = false;
  return () => {
    if (isRequested) return;
    isRequested = true;
    requestAnimationFrame(() => {
      isRequested = false;
      act();
    });
  };
}

export function css([r, g, b]: readonly [number, number, number]): string {
  return `rgb(${Math.round(r * 255)} ${Math.round(g * 255)} ${Math.round(b * 255)})`;
}

/** Format a number with at most four digits and without trailing zeros. */
export function formatNumber(value: number): string {
  if (!Number.isFinite(value)) return "—";
  return Math.abs(value) >= 10000 || Number.isInteger(value) ? String(Math.round(value)) : String(Number(value.toPrecision(4)));
}
