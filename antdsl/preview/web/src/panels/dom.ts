// Elements, built without markup: words from users are always text. `keyed` renews a list and leaves alone what stays in it.

type Child = Node | string | null | undefined | false;
interface Props {
  class?: string;
  test?: string; // what tests find it by: data-test
  text?: string | number;
  on?: { [K in keyof HTMLElementEventMap]?: (event: HTMLElementEventMap[K]) => void };
  [attribute: string]: unknown;
}

/** An element with attributes: `true` gives an empty one, `false`, null and undefined none. */
export function el<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  props: Props = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(props)) {
    if (value === null || value === undefined || value === false) continue;
    if (name === "class") made.className = String(value);
    else if (name === "text") made.textContent = String(value);
    else if (name === "test") made.dataset.test = String(value);
    else if (name === "on") listen(made, value as NonNullable<Props["on"]>);
    else made.setAttribute(name, value === true ? "" : String(value));
  }
  made.append(...(children.filter(Boolean) as (Node | string)[]));
  return made;
}

function listen(element: HTMLElement, on: NonNullable<Props["on"]>): void {
  for (const [event, heard] of Object.entries(on)) element.addEventListener(event, heard as EventListener);
}

/** A button with words, or with a sign and words for those who do not see it. */
export function button(words: string, pressed: () => void, props: Props = {}): HTMLButtonElement {
  return el("button", { type: "button", text: words, ...props, on: { click: pressed } });
}

export function svg<K extends keyof SVGElementTagNameMap>(
  tag: K,
  props: Record<string, string | number> = {},
): SVGElementTagNameMap[K] {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(props)) made.setAttribute(name, String(value));
  return made;
}

/** Set an element's words only where they are other ones: no reader is told of the same twice. */
export function say(element: Element, words: string): void {
  if (element.textContent !== words) element.textContent = words;
}

export interface Row<T> {
  element: Element;
  update: (item: T) => void;
}

/** Show a list: a row for each key, made once and then only renewed, so that nothing moves away under a pointer. */
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
      const wanted: Element | null = before ? before.nextElementSibling : place.firstElementChild;
      if (row.element !== wanted) place.insertBefore(row.element, wanted);
      before = row.element;
    }
  };
}

/** Do it at most once in `wait` ms, with the last arguments, which always get through. */
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

/** Do it before the page is drawn again, once however often it was asked for. */
export function painted(act: () => void): () => void {
  let asked = false;
  return () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => {
      asked = false;
      act();
    });
  };
}

export function css([r, g, b]: readonly [number, number, number]): string {
  return `rgb(${Math.round(r * 255)} ${Math.round(g * 255)} ${Math.round(b * 255)})`;
}

/** A number as people write it: four digits, no tail of zeros. */
export function shown(value: number): string {
  if (!Number.isFinite(value)) return "—";
  return Math.abs(value) >= 10000 || Number.isInteger(value) ? String(Math.round(value)) : String(Number(value.toPrecision(4)));
}
