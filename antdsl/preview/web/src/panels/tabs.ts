// Tabs with keyboard navigation: left, right, home and end. Only the selected tab is in the tab order.

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
  private chosenByUser = ""; // the tab that the user chose
  private missingChoice = ""; // the same tab while it does not exist, such as a file that is missing for a moment

  constructor(
    label: string,
    private readonly prefix: string,
    private readonly panel: (id: string) => string, // returns the id of the panel that a tab opens
    private readonly chosen: (id: string) => void,
  ) {
    this.list = el("div", { role: "tablist", "aria-label": label, class: "tabs", on: { keydown: (event) => this.onKey(event) } });
  }

  get now(): string {
    return this.shown;
  }

  /** Replace the tabs. The selected tab stays selected while it exists. */
  renew(tabs: readonly Tab[]): void {
    for (const [id, button] of this.buttons) {
      if (tabs.some((tab) => tab.id === id)) continue;
      button.remove();
      this.buttons.delete(id);
      if (id === this.chosenByUser || (id === this.shown && !this.missingChoice)) this.missingChoice = id;
    }
    for (const [number, tab] of tabs.entries()) {
      const button = this.buttons.get(tab.id) ?? this.createButton(tab.id);
      if (button.firstChild) button.firstChild.textContent = tab.label;
      else button.append(tab.label);
      if (tab.title) button.title = tab.title;
      if (this.list.children[number] !== button) this.list.insertBefore(button, this.list.children[number] ?? null);
    }
    if (this.buttons.has(this.missingChoice)) this.chooseForUser(this.missingChoice);
    else if (!this.buttons.has(this.shown) && tabs[0]) this.choose(tabs[0].id);
  }

  /** Show a mark on a tab, such as a count of errors; an empty string removes it. */
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

  /** Select a tab for the user. It is selected again after a moment in which it did not exist. */
  chooseForUser(id: string): void {
    this.chosenByUser = id;
    this.missingChoice = "";
    this.choose(id);
  }

  private createButton(id: string): HTMLButtonElement {
    const button = el("button", {
      type: "button",
      role: "tab",
      id: `${this.prefix}-tab-${id}`,
      test: `${this.prefix}-tab-${id}`,
      "aria-controls": this.panel(id),
      "aria-selected": "false",
      on: { click: () => this.chooseForUser(id) },
    });
    button.tabIndex = -1;
    this.buttons.set(id, button);
    return button;
  }

  private onKey(event: KeyboardEvent): void {
    const all = [...this.buttons.keys()];
    const at = all.indexOf(this.shown);
    const to = { ArrowRight: at + 1, ArrowLeft: at - 1, Home: 0, End: all.length - 1 }[event.key];
    if (to === undefined) return;
    const id = all[(to + all.length) % all.length] as string;
    this.chooseForUser(id);
    this.buttons.get(id)?.focus();
    event.preventDefault();
  }
}
