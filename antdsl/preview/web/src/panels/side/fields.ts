// The fields of a verb: a label, a text and a button for a click in the view where a key is a place.

import { type List, namePlace, PICKED, putPlace, type Verb, type VerbKey } from "../../directing";
import type { Store } from "../../store";
import { button, el, setText } from "../dom";

export interface Fields {
  elements: HTMLElement[];
  values(): Record<string, string>;
  /** Show the problems of each key, by their text. */
  showProblems(words: (key: string) => string): void;
  /** Replace the values to choose from, by key. Other keys keep theirs. */
  setChoices(choices: Record<string, string[]>): void;
  /** Show which key waits for a click in the view. */
  showPicking(): void;
  /** Fill in the current frame where the user has written none. Return whether a value changed. */
  setFrame(): boolean;
}

interface Field {
  key: VerbKey;
  element: HTMLElement;
  input: HTMLInputElement;
  wrong: HTMLElement;
  names: HTMLDataListElement;
  showPicking: (() => void) | undefined;
}

/** Return the fields of a verb of a list. `explain` gets the help of the field that gets the focus. */
export function makeFields(store: Store, list: List, verb: Verb, changed: () => void, explain: (help: string) => void): Fields {
  const all = verb.keys.map((key) => makeField(store, verb, key, changed));
  for (const each of all) each.element.addEventListener("focusin", () => explain(each.key.help));
  const narrowing = all.filter((each) => each.key.narrows);
  const elements = all.filter((each) => !each.key.narrows).map((each) => each.element);
  if (narrowing.length)
    elements.push(
      el(
        "details",
        { class: "narrow-keys" },
        el("summary", { text: "Only some of these agents" }),
        ...narrowing.map((each) => each.element),
      ),
    );
  const fields: Fields = {
    elements,
    values: () =>
      Object.fromEntries(all.map(({ key, input }) => [key.name, input.value.trim()]).filter(([, value]) => value !== "")),
    showProblems: (words) => {
      for (const { key, wrong } of all) write(wrong, words(key.name));
    },
    setChoices: (choices) => {
      for (const { key, names } of all) if (choices[key.name]) names.replaceChildren(...options(choices[key.name] ?? []));
    },
    showPicking: () => {
      for (const each of all) each.showPicking?.();
    },
    setFrame: () => {
      let any = false;
      for (const { key, input } of all) {
        const value = list === "notes" || key.required ? initialFrame(store, key) : ""; // edits apply to all frames without
        if (!value || input.dataset.written || input.value === value) continue;
        input.value = value;
        any = true;
      }
      return any;
    },
  };
  fields.setFrame();
  return fields;
}

/** Return the value of a key for frames: from the current frame on; one frame is a second later. */
function initialFrame(store: Store, key: VerbKey): string {
  const { status, scene } = store.now;
  if (!status || !scene || status.playing) return "";
  const second = status.frame + Math.round(scene.fps);
  if (key.kind === "frame") return String(second);
  return key.kind === "frames" ? `${status.frame}..${Math.max(scene.last, second)}` : "";
}

function makeField(store: Store, verb: Verb, key: VerbKey, changed: () => void): Field {
  const list = `direct-${verb.verb}-${key.name}`;
  const input = el("input", {
    type: "text",
    spellcheck: "false",
    maxlength: 2000,
    placeholder: key.default || `${key.required ? "" : "– "}${key.example}`,
    list,
    title: key.help,
    test: `direct-key-${key.name}`,
  });
  input.addEventListener("input", () => {
    input.dataset.written = "yes";
    changed();
  });
  const wrong = problem(`direct-wrong-${key.name}`);
  const names = el("datalist", { id: list, test: `direct-choices-${key.name}` }, ...options(key.choices));
  const pick = makePick(store, key, input, changed);
  const row = el("div", { class: "control" }, labelled(key.name, input), pick?.button);
  return { key, input, wrong, names, showPicking: pick?.show, element: el("div", { class: "field" }, row, names, wrong) };
}

function options(values: string[]): HTMLElement[] {
  return values.map((value) => el("option", { value }));
}

interface Pick {
  button: HTMLButtonElement;
  show: () => void;
}

/** Return a button that waits for a click in the view; null for keys that are no places. A path takes one click after another. */
function makePick(store: Store, key: VerbKey, input: HTMLInputElement, changed: () => void): Pick | null {
  const wanted = PICKED[key.kind];
  if (!wanted) return null;
  const things = ["the ground", wanted.items && "an item", wanted.agents && "an agent"].filter(Boolean).join(", ");
  const own = {
    ...wanted,
    pick: (place: Parameters<typeof namePlace>[0]) => {
      const { verbs, scene } = store.now;
      const words = verbs && scene ? namePlace(place, verbs, scene.unit_mm) : "";
      if (!words) return;
      input.value = putPlace(key, input.value.trim(), words);
      input.dataset.written = "yes";
      if (!["path", "points"].includes(key.kind)) store.set("picking", null);
      changed();
    },
  };
  const made = button("Pick", () => store.set("picking", store.now.picking === own ? null : own), {
    class: "small",
    title: `click ${things} in the view`,
    "aria-label": `pick ${key.name}: click ${things} in the view`,
    "aria-pressed": "false",
    test: `direct-pick-${key.name}`,
  });
  return { button: made, show: () => made.setAttribute("aria-pressed", String(store.now.picking === own)) };
}

/** Return a field with a label before it. */
export function labelled(words: string, input: HTMLElement): HTMLLabelElement {
  return el("label", {}, el("span", { class: "name", text: words }), input);
}

/** Return an element for what is wrong. It is hidden while empty. */
export function problem(test: string): HTMLElement {
  return el("p", { class: "bad-note", test, role: "alert", hidden: true });
}

/** Write what is wrong into its element. */
export function write(element: HTMLElement, words: string): void {
  element.hidden = !words;
  setText(element, words);
}
