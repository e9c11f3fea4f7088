// The states of an agent over its life, one strip per machine, in the colours of the states. A click seeks to that frame.

import type { Explanation } from "../../explanation";
import type { Store } from "../../store";
import { button, css, el } from "../dom";
import { seek } from "../playing";
import { section } from "./parts";

type Stretch = Explanation["strip"][number];

export function strips(store: Store, e: Explanation): HTMLElement[] {
  const machines = [...new Set(e.strip.map((each) => each.machine))];
  const rows = machines.map((machine) => strip(store, e, machine, machines.length > 1));
  return rows.length ? [section("States over time", ...rows)] : [];
}

function strip(store: Store, e: Explanation, machine: string, several: boolean): HTMLElement {
  const stretches = e.strip.filter((each) => each.machine === machine);
  const first = Math.min(...stretches.map((each) => each.first));
  const last = Math.max(...stretches.map((each) => each.last)) + 1;
  const bar = el("div", { class: "strip", test: `strip-${machine}` });
  for (const each of stretches) {
    const piece = el("span", { title: `${each.state || "alive"}, frames ${each.first} to ${each.last}` });
    piece.style.left = `${((each.first - first) / (last - first)) * 100}%`;
    piece.style.width = `${((each.last + 1 - each.first) / (last - first)) * 100}%`;
    piece.style.background = colour(store, e, machine, each.state);
    bar.append(piece);
  }
  const needle = el("i");
  needle.style.left = `${((e.frame + 0.5 - first) / (last - first)) * 100}%`;
  bar.append(needle);
  bar.addEventListener("click", (event) => {
    const box = bar.getBoundingClientRect();
    const frame = Math.min(last - 1, first + Math.floor(((event.clientX - box.left) / box.width) * (last - first)));
    seek(store, frame);
  });
  const at = stretches.findIndex((each) => each.first <= e.frame && e.frame <= each.last);
  return el(
    "div",
    { class: "strip-row" },
    several && el("span", { class: "quiet", text: machine }),
    bar,
    moves(store, e, stretches, at),
  );
}

/** Return buttons, for keys too: to the start of this state, and to the next state. */
function moves(store: Store, e: Explanation, stretches: Stretch[], at: number): HTMLElement {
  const now = stretches[at];
  const before = now && now.first < e.frame ? now.first : stretches[at - 1]?.first;
  const after = stretches[at + 1]?.first;
  const move = (words: string, frame: number | undefined, title: string) =>
    button(words, () => frame !== undefined && seek(store, frame), {
      class: "small",
      title,
      "aria-label": title,
      disabled: frame === undefined,
    });
  return el(
    "div",
    { class: "strip-words" },
    move("◂", before, "to the previous change"),
    el("span", { text: now ? `${now.state || "alive"} ${now.first === now.last ? now.first : `${now.first}–${now.last}`}` : "" }),
    move("▸", after, "to the next change"),
  );
}

function colour(store: Store, e: Explanation, machine: string, state: string): string {
  const machines = store.now.scene?.species.find((each) => each.name === e.species)?.machines ?? [];
  const found = machines.find((each) => each.name === machine) ?? machines[0];
  const shade = found?.colours[found.states.indexOf(state)];
  return shade ? css(shade) : "var(--quiet)";
}
