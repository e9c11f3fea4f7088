// Tabs that keys move through: left and right, home and end; one of them is in the order of the tab key.

import { el } from "./dom";

export interface Tab {
  id: string;
  label: string;
  title?: string;
}

export class Tabs {
  readonly list: HTMLElement;
  private readonly buttons = new Map<string, HTMLButtonElement>();
  private shown = "";
  private wanted = ""; // what was chosen by a person
  private missed = ""; // the same, while there is no such tab: a file that is gone for a moment

  constructor(
    label: string,
    private readonly prefix: string,
    private readonly panel: (id: string) => string, // the id of the panel that a tab opens
    private readonly chosen: (id: string) => void,
  ) {
    this.list = el("div", { role: "tablist", "aria-label": label, class: "tabs", on: { keydown: (event) => this.moved(event) } });
  }

  get now(): string {
    return this.shown;
  }

  /** Have these tabs; the one that was shown stays shown while it is there. */
  renew(tabs: readonly Tab[]): void {
    for (const [id, button] of this.buttons) {
      if (tabs.some((tab) => tab.id === id)) continue;
      button.remove();
      this.buttons.delete(id);
      if (id === this.wanted || (id === this.shown && !this.missed)) this.missed = id;
    }
    for (const [number, tab] of tabs.entries()) {
      const button = this.buttons.get(tab.id) ?? this.made(tab.id);
      if (button.firstChild) button.firstChild.textContent = tab.label;
      else button.append(tab.label);
      if (tab.title) button.title = tab.title;
      if (this.list.children[number] !== button) this.list.insertBefore(button, this.list.children[number] ?? null);
    }
    if (this.buttons.has(this.missed)) this.want(this.missed);
    else if (!this.buttons.has(this.shown) && tabs[0]) this.choose(tabs[0].id);
  }

  /** Hang a mark on a tab, such as how many errors there are; an empty one is none. */
  mark(id: string, words: string): void {
    const button = this.buttons.get(id);
    if (!button) return;
    button.querySelector(".count")?.remove();
    if (words) button.append(el("span", { class: "count", text: words }));
  }

  choose(id: string): void {
    if (!this.buttons.has(id)) return;
    this.shown = id;
    for (const [name, button] of this.buttons) {
      button.setAttribute("aria-selected", String(name === id));
      button.tabIndex = name === id ? 0 : -1;
    }
    this.chosen(id);
  }

  /** Choose as a person does: it is come back to when it was gone for a moment. */
  want(id: string): void {
    this.wanted = id;
    this.missed = "";
    this.choose(id);
  }

  private made(id: string): HTMLButtonElement {
    const button = el("button", {
      type: "button",
      role: "tab",
      id: `${this.prefix}-tab-${id}`,
      test: `${this.prefix}-tab-${id}`,
      "aria-controls": this.panel(id),
      "aria-selected": "false",
      on: { click: () => this.want(id) },
    });
    button.tabIndex = -1;
    this.buttons.set(id, button);
    return button;
  }

  private moved(event: KeyboardEvent): void {
    const all = [...this.buttons.keys()];
    const at = all.indexOf(this.shown);
    const to = { ArrowRight: at + 1, ArrowLeft: at - 1, Home: 0, End: all.length - 1 }[event.key];
    if (to === undefined) return;
    const id = all[(to + all.length) % all.length] as string;
    this.want(id);
    this.buttons.get(id)?.focus();
    event.preventDefault();
  }
}
