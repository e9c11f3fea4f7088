// The borders between text, view and panels: dragged, or moved by left and right; remembered by the browser.

import { el } from "./dom";

interface Split {
  name: string; // the variable that has the column's share
  words: string;
  first: number; // percent of the window
  before: boolean; // whether its column is the one before the border
}
const SPLITS: Split[] = [
  { name: "--text-wide", words: "width of the text", first: 29, before: true },
  { name: "--side-wide", words: "width of the panels", first: 27, before: false },
];
const [LEAST, MOST] = [12, 45];

export function splits(_: unknown, place: HTMLElement): void {
  const main = place.closest("main") as HTMLElement;
  main.style.position = "relative";
  for (const split of SPLITS) main.append(border(split, main));
}

function border(split: Split, main: HTMLElement): HTMLElement {
  const kept = `antdsl${split.name}`;
  const made = el("div", {
    class: "splitter",
    role: "separator",
    tabindex: 0,
    "aria-orientation": "vertical",
    "aria-label": split.words,
    "aria-valuemin": LEAST,
    "aria-valuemax": MOST,
  });
  let now = 0;
  const set = (share: number) => {
    now = Math.min(MOST, Math.max(LEAST, share));
    document.documentElement.style.setProperty(split.name, `${now}%`);
    made.style[split.before ? "left" : "right"] = `${now}%`;
    if (!split.before) made.style.marginRight = "-4px";
    made.setAttribute("aria-valuenow", String(Math.round(now)));
    localStorage.setItem(kept, String(now));
  };
  set(Number.parseFloat(localStorage.getItem(kept) ?? "") || split.first);
  made.addEventListener("pointerdown", (event) => made.setPointerCapture(event.pointerId));
  made.addEventListener("pointermove", (event) => {
    if (!made.hasPointerCapture(event.pointerId)) return;
    const box = main.getBoundingClientRect();
    set(((split.before ? event.clientX - box.left : box.right - event.clientX) / box.width) * 100);
  });
  made.addEventListener("dblclick", () => set(split.first));
  made.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!step) return;
    event.preventDefault();
    set(now + (split.before ? step : -step));
  });
  return made;
}
