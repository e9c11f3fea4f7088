// The list of curves with check boxes, in groups. At first, curves of states and specs are displayed.

import type { Store } from "../../store";
import { el, keyed, type Row, setText } from "../dom";
import type { CurveData } from "./data";
import { type Group, type Named, named } from "./naming";

const GROUPS: [Group, string][] = [
  ["states", "Agents in each state"],
  ["counts", "Agents and items"],
  ["specs", "Specs: whether they hold"],
];
const FIRST = 12; // maximum number of state curves at first

/** The names of displayed curves and of all curves. `changes` counts the changes. */
export class Chosen {
  all: Named[] = [];
  shown: Named[] = [];
  readonly hand = new Map<string, boolean>(); // choices of the user

  renew(names: readonly string[], store: Store): void {
    this.all = names.map((name, order) => named(name, store.now.scene, order));
    let states = 0;
    this.shown = this.all.filter(
      (each) => this.hand.get(each.name) ?? (each.group === "specs" || (each.group === "states" && states++ < FIRST)),
    );
  }
}

export const chosen = new Chosen();

export function chooser(store: Store, data: CurveData, draw: () => void): HTMLElement {
  const summary = el("summary", { text: "curves", test: "curve-chooser" });
  const details = el("details", { class: "chooser" }, summary);
  const box = el("div", { class: "choices" });
  details.append(box);
  const renew = () => {
    chosen.renew(data.names, store);
    for (const [group, show] of groups) show(chosen.all.filter((each) => each.group === group));
    draw();
  };
  const groups = GROUPS.map(([group, title]) => {
    const list = el("div");
    const part = el("fieldset", {}, el("legend", { text: title }), list);
    box.append(part);
    const rows = keyed<Named>(
      list,
      (each) => each.name,
      () => row(renew),
    );
    return [
      group,
      (items: readonly Named[]) => {
        part.hidden = items.length === 0;
        rows(items);
      },
    ] as const;
  });
  let seen = "";
  store.on(["scene", "curves"], () => {
    const now = data.names.join("\n");
    if (now !== seen || details.open) renew();
    seen = now;
  });
  store.on("scene", renew);
  details.addEventListener("keydown", (event) => {
    if (event.key !== "Escape") return;
    details.open = false;
    summary.focus();
  });
  document.addEventListener("pointerdown", (event) => {
    if (!details.contains(event.target as Node)) details.open = false;
  });
  return details;
}

function row(renew: () => void): Row<Named> {
  let name = "";
  const box = el("input", { type: "checkbox" });
  const swatch = el("span", { class: "swatch" });
  const words = el("span");
  box.addEventListener("change", () => {
    chosen.hand.set(name, box.checked);
    renew();
  });
  return {
    element: el("label", { class: "tick" }, box, swatch, words),
    update: (each) => {
      name = each.name;
      box.checked = chosen.shown.some((one) => one.name === name);
      box.dataset.test = `curve-${name}`;
      swatch.style.background = each.colour;
      setText(words, each.words);
    },
  };
}
