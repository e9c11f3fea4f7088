// The borders between text, view and panels. The pointer and the left and right keys move them; the browser stores them.

import { el } from "./dom";

interface Split {
  name: string; // CSS variable with the width of the column
  words: string;
  first: number; // initial width, percent of the window
  before: boolean; // whether the column is to the left of the border
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
  const storageKey = `antdsl${split.name}`;
  const element = el("div", {
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
    element.style[split.before ? "left" : "right"] = `${now}%`;
    if (!split.before) element.style.marginRight = "-4px";
    element.setAttribute("aria-valuenow", String(Math.round(now)));
    localStorage.setItem(storageKey, String(now));
  };
  set(Number.parseFloat(localStorage.getItem(storageKey) ?? "") || split.first);
  element.addEventListener("pointerdown", (event) => element.setPointerCapture(event.pointerId));
  element.addEventListener("pointermove", (event) => {
    if (!element.hasPointerCapture(event.pointerId)) return;
    const box = main.getBoundingClientRect();
    set(((split.before ? event.clientX - box.left : box.right - event.clientX) / box.width) * 100);
  });
  element.addEventListener("dblclick", () => set(split.first));
  element.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!step) return;
    event.preventDefault();
    set(now + (split.before ? step : -step));
  });
  return element;
}
