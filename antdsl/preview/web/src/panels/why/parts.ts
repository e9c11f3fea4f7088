// A condition with the values of its parts, indented; and links to lines of the text.

import type { Part, Place } from "../../explanation";
import type { Store } from "../../store";
import { el } from "../dom";
import { shortName } from "../text/files";

/** Return code that links to its line. */
export function link(store: Store, place: Place, words = place.text): HTMLElement {
  return el("button", {
    type: "button",
    class: "code link",
    text: words,
    title: `${place.text}\n${shortName(place.file)}:${place.line}`,
    on: { click: () => store.set("goto", { file: place.file, line: place.line }) },
  });
}

/** Return the parts of a condition that add information; for joined conditions, the joined ones. */
export function conditionParts(whole: Part, timed: boolean): HTMLElement | null {
  const parts = whole.role === "joined" && !timed ? whole.parts : [whole];
  return parts.length ? el("ul", { class: "parts" }, ...parts.map(partRow)) : null;
}

function partRow(given: Part): HTMLElement {
  const inner = given.parts[0];
  const part = given.parts.length === 1 && inner && inner.text === given.text ? inner : given;
  const label = part.role === "draw" || part.role === "bar" ? part.role : part.text;
  const value = el("b", { class: part.value === true ? "yes" : part.value === false ? "no" : "", text: part.shown });
  const row = el(
    "li",
    {},
    el("span", { class: "part", title: part.text }, el("code", { text: label }), el("span", { class: "gap" }), value),
  );
  if (part.parts.length) row.append(el("ul", { class: "parts" }, ...part.parts.map(partRow)));
  return row;
}

export function section(title: string, ...children: (Node | null)[]): HTMLElement {
  return el("section", {}, el("h3", { text: title }), ...children);
}

/** Return a section that is closed at first. Later, sections with the same name keep their open or closed state. */
export function folded(title: string, count: number, ...children: Node[]): HTMLElement {
  const details = el(
    "details",
    { class: "fold" },
    el("summary", {}, title, el("span", { class: "count", text: String(count) })),
    ...children,
  );
  details.dataset.name = title;
  return details;
}
