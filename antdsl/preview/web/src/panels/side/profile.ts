// The cost of a step: by phase, by layer, by line. Measuring is off at first.

import type { Profile } from "../../protocol";
import type { Store } from "../../store";
import { el, keyed, type Row, setText } from "../dom";
import type { Panel } from "../side";
import { shortName } from "../text/files";

interface Cost {
  key: string;
  words: string;
  file: string;
  line: number;
  ms: number;
  share: number; // relative to the maximum of its list
}
const LINES = 20;
const LATE = 2000; // ms

export const profile: Panel = (store, place) => {
  let off = -LATE;
  const box = el("input", { type: "checkbox", test: "profile-on" });
  box.addEventListener("change", () => {
    store.connection.ask({ op: "profile", on: box.checked }, true);
    if (box.checked) return;
    body.hidden = true;
    store.set("profile", null);
    off = performance.now();
  });
  const total = el("p", { class: "total", test: "profile-total" });
  const body = el("div", { hidden: true, test: "profile" }, total);
  const lists = (["Phases of a step", "Layers, with all they call", `The ${LINES} dearest lines`] as const).map((title) => {
    const list = el("ul", { class: "costs" });
    const section = el("section", {}, el("h3", { text: title }), list);
    body.append(section);
    const show = keyed<Cost>(
      list,
      (cost) => cost.key,
      () => row(store),
    );
    return (listed: readonly Cost[]) => {
      section.hidden = listed.length === 0;
      show(listed);
    };
  });
  place.append(
    el("label", { class: "tick switch" }, box, "measure where the time goes"),
    el("p", { class: "note", text: "The results stay the same to the bit. The costs also appear beside the lines of the text." }),
    body,
  );
  store.connection.on("profile", (message) => {
    if (!box.checked && performance.now() - off < LATE) return; // a message from before measuring was switched off
    box.checked = true; // also if another page switched it on
    store.set("profile", message);
    body.hidden = false;
    setText(total, `${ms(message.total)} per frame, over the last ${message.frames} frames`);
    for (const [k, each] of costs(message).entries()) lists[k]?.(each);
  });
};

function costs(message: Profile): Cost[][] {
  const phases = message.phases.map((each) => ({ key: each.name, words: each.name, file: "", line: 0, ms: each.ms }));
  const layers = message.layers.map((each) => ({
    key: `${each.species} ${each.file}:${each.line} ${each.text}`,
    words: each.text,
    file: each.file,
    line: each.line,
    ms: each.ms,
  }));
  const lines = message.lines.map((each) => ({
    key: `${each.file}:${each.line}`,
    words: each.text,
    file: each.file,
    line: each.line,
    ms: each.ms,
  }));
  return [phases, layers, lines.sort((a, b) => b.ms - a.ms).slice(0, LINES)].map((all) => {
    const most = Math.max(...all.map((each) => each.ms), 1e-9);
    return all.map((each) => ({ ...each, share: each.ms / most }));
  });
}

function row(store: Store): Row<Cost> {
  let now: Cost | null = null;
  const words = el("span", { class: "words" });
  const number = el("span", { class: "value" });
  const go = el(
    "button",
    {
      type: "button",
      class: "cost-row",
      on: { click: () => now?.file && store.set("goto", { file: now.file, line: now.line }) },
    },
    words,
    number,
  );
  const element = el("li", {}, go);
  return {
    element,
    update: (cost) => {
      now = cost;
      setText(words, cost.words);
      setText(number, ms(cost.ms));
      go.disabled = !cost.file;
      go.title = cost.file ? `${cost.words}\n${shortName(cost.file)}:${cost.line}` : cost.words;
      element.style.setProperty("--share", String(cost.share));
    },
  };
}

function ms(value: number): string {
  return `${value >= 9.95 ? value.toFixed(1) : value.toFixed(2)} ms`;
}
