// The state machines during the run: counts per state and recent changes. A click on a state selects its agents.

import type { Chart } from "../../protocol";
import { button, el, setText } from "../dom";
import { Counter } from "../machine/counter";
import { ChartDrawing } from "../machine/drawing";
import { Flow } from "../machine/flow";
import type { Panel } from "../side";

const EVERY = 150; // ms between two counts

export const machine: Panel = (store, place, shown) => {
  const note = el("p", {
    class: "note",
    text: "Click a state to select its agents. The width of an arrow shows the changes in the last second; rest the pointer on it for its conditions.",
  });
  const need = el("p", { class: "note", test: "charts-need", hidden: true });
  const pick = el("select", { "aria-label": "Machine", test: "machine-pick" });
  const host = el("div", { class: "chart-host", test: "chart" });
  const dialog = enlarged(host, () => drawing?.fit());
  const larger = button("Enlarge", () => dialog.open(), { class: "small larger", test: "chart-enlarge" });
  place.append(larger, pick, host, note, need, dialog.element);
  new ResizeObserver(() => drawing?.fit()).observe(host);
  const counter = new Counter(store);
  const flow = new Flow(store);
  let drawing: ChartDrawing | null = null;
  let drawn = "";

  const chart = (): Chart | undefined =>
    store.now.scene?.charts.find((each) => each.title === pick.value) ?? store.now.scene?.charts[0];
  const count = () => {
    const now = chart();
    if (!drawing || !now || !shown.shown()) return;
    drawing.counts(counter.states(now.species, now.machine));
    drawing.flow(flow.rates(now));
  };
  const redraw = () => {
    const scene = store.now.scene;
    const charts = scene?.charts ?? [];
    need.hidden = !scene?.charts_need;
    setText(need, scene?.charts_need ?? "");
    const titles = charts.map((each) => each.title);
    if (titles.join("\n") !== [...pick.options].map((each) => each.value).join("\n")) {
      pick.replaceChildren(...titles.map((value) => el("option", { value, text: value })));
    }
    pick.hidden = titles.length < 2;
    note.hidden = larger.hidden = titles.length === 0;
    const now = chart();
    const key = JSON.stringify(now);
    if (key === drawn) return;
    drawn = key;
    drawing = now
      ? new ChartDrawing(now, (state) => store.set("selected", counter.agents(now.species, now.machine, state)))
      : null;
    host.replaceChildren(...(drawing ? [drawing.element] : []));
    drawing?.fit();
    count();
    mark();
  };
  const mark = () => {
    const now = chart();
    const one = store.now.selected.length === 1 ? store.now.selected[0] : undefined;
    drawing?.mark(now && one && one.species === now.species ? counter.stateOf(now.species, now.machine, one.id) : null);
  };
  store.on("scene", redraw);
  pick.addEventListener("change", redraw);
  store.on("selected", mark);
  shown.onVisibilityChange(() => {
    count();
    mark();
  });
  setInterval(() => {
    if (!counter.changed) return;
    counter.changed = false;
    count();
    mark();
  }, EVERY);
};

/** Enlarge the chart to the size of the window, in a dialog; closing the dialog moves it back. */
function enlarged(host: HTMLElement, fit: () => void) {
  const close = button("Close", () => element.close(), { class: "small larger" });
  const element = el("dialog", { class: "enlarged", "aria-label": "States" }, close);
  const home = document.createComment("chart");
  element.addEventListener("close", () => {
    home.replaceWith(host);
    fit();
  });
  return {
    element,
    open: () => {
      host.replaceWith(home);
      element.append(host);
      element.showModal();
      fit();
    },
  };
}
