// The names of the displayed curves, with their values at the pointer or at the current frame.

import type { Store } from "../../store";
import { el, keyed, oncePerRepaint, type Row, setText, formatNumber } from "../dom";
import type { Chart } from "./chart";
import { chosen } from "./chooser";
import type { CurveData } from "./data";
import type { Named } from "./naming";

export function legend(store: Store, data: CurveData, chart: Chart): HTMLElement {
  const list = el("ul", { class: "legend", test: "legend" });
  const where = el("span", { class: "quiet at" });
  const branch = el("span", { class: "quiet branches", test: "branches" });
  const rows = keyed<[Named, number | null]>(list, ([each]) => each.name, row);
  const show = oncePerRepaint(() => {
    const frame = chart.hover ?? store.now.status?.frame ?? 0;
    setText(where, [chart.hover === null ? "now" : `at frame ${frame}`, chart.stops.get(frame)].filter(Boolean).join(": "));
    rows(chosen.shown.map((each) => [each, data.valueAt(each.name, frame)]));
    const last = data.branches.at(-1);
    setText(branch, last ? `╌╌ before: ${last.line || "edited"}, at frame ${last.first}` : "");
    branch.title = data.branches.map((each) => `at frame ${each.first}: ${each.line}`).join("\n");
  });
  chart.drawn = show;
  return el("div", { class: "legend-box" }, el("div", { class: "row" }, branch, where), list);
}

function row(): Row<[Named, number | null]> {
  const swatch = el("span", { class: "swatch" });
  const words = el("span", { class: "words" });
  const value = el("span", { class: "value" });
  return {
    element: el("li", {}, swatch, words, value),
    update: ([each, now]) => {
      swatch.style.background = each.colour;
      setText(words, each.words);
      words.title = each.name;
      setText(
        value,
        now === null
          ? "–"
          : each.group === "specs"
            ? now
              ? "holds"
              : "fails"
            : Number.isInteger(now)
              ? now.toLocaleString("en")
              : formatNumber(now),
      );
    },
  };
}
