// A condition with the values of all that it is made of, indented; and links to places of the text.

import type { Part, Place } from "../../explanation";
import type { Store } from "../../store";
import { el } from "../dom";
import { shortName } from "../text/files";

/** Words of the program that lead to their line. */
export function link(store: Store, place: Place, words = place.text): HTMLElement {
  return el("button", {
    type: "button",
    class: "code link",
    text: words,
    title: `${place.text}\n${shortName(place.file)}:${place.line}`,
    on: { click: () => store.set("goto", { file: place.file, line: place.line }) },
  });
}

/** The parts of a condition that say more than whether it holds: of one that is joined, what it joins. */
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

/** A section that is closed at first; what was open stays so, by its name. */
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
