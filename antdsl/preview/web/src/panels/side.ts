// The panels at the side, of which one is visible. A new panel is one file and one line of PANELS.

import type { Store } from "../store";
import { el } from "./dom";
import { breaks } from "./side/breaks";
import { direct } from "./side/direct";
import { look } from "./side/look";
import { machine } from "./side/machine";
import { profile } from "./side/profile";
import { sliders } from "./side/sliders";
import { why } from "./side/why";
import { Tabs } from "./tabs";

/** What a panel gets. `shown`: whether it is visible; `onVisibilityChange`: adds a listener; `mark`: sets its tab's mark. */
export interface Shown {
  shown: () => boolean;
  onVisibilityChange: (listener: () => void) => void;
  mark: (words: string) => void;
}
export type Panel = (store: Store, place: HTMLElement, shown: Shown) => void;

const PANELS: [id: string, label: string, title: string, panel: Panel][] = [
  ["why", "Why", "why the selected agent did what it did", why],
  ["direct", "Direct", "notes and edits for agents: what they do in some frames", direct],
  ["sliders", "Sliders", "numbers of the program, layers and fields", sliders],
  ["view", "View", "what the view displays, and how", look],
  ["machine", "States", "the states and the changes between them", machine],
  ["profile", "Cost", "the cost of a step", profile],
  ["breaks", "Stops", "breakpoints", breaks],
];

export function side(store: Store, place: HTMLElement): void {
  const places = new Map<string, HTMLElement>();
  const listeners: (() => void)[] = [];
  const tabs = new Tabs(
    "Panels",
    "side",
    (id) => `side-${id}`,
    (id) => {
      for (const [name, panel] of places) panel.hidden = name !== id;
      for (const listener of listeners) listener();
    },
  );
  place.append(tabs.list);
  tabs.renew(PANELS.map(([id, label, title]) => ({ id, label, title })));
  for (const [id, , , panel] of PANELS) {
    const own = el("div", {
      class: "panel",
      role: "tabpanel",
      id: `side-${id}`,
      "aria-labelledby": `side-tab-${id}`,
      tabindex: 0,
      test: `panel-${id}`,
    });
    places.set(id, own);
    place.append(own);
    own.hidden = id !== tabs.now;
    panel(store, own, {
      shown: () => tabs.now === id,
      onVisibilityChange: (listener) => listeners.push(listener),
      mark: (words) => tabs.mark(id, words),
    });
  }
  let before = 0;
  store.on("selected", () => {
    // the first selection opens the panel Why, unless agents are selected for a note; later selections keep the current panel
    if (before === 0 && store.now.selected.length === 1 && tabs.now !== "direct") tabs.choose("why");
    before = store.now.selected.length;
  });
}
