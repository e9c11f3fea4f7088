// The notes or edits that pages added: each can be switched off, copied and removed; and all of them as text for a file.

import type { Line, List, Settling } from "../../directing";
import type { Store } from "../../store";
import { button, el, keyed, type Row, setText } from "../dom";
import { copyButton } from "./copying";
import { problem, write } from "./fields";

const WORDS: Record<List, { title: string; where: (file: string) => string }> = {
  notes: { title: "Notes of this run", where: (file) => `To keep them, write them below \`notes:\` in ${file}.` },
  edits: {
    title: "Edits of these frames",
    where: (file) =>
      `To keep them, write them into a file ${file}; \`antdsl edit CACHE --edits ${file}\` applies them to a cache, and with \`--settle\` settles it.`,
  },
};

/** Return a list of lines. `counted` gets their number. */
export function lines(store: Store, listed: List, counted: (count: number) => void): HTMLElement {
  const list = el("ul", { class: "lines notes", test: listed });
  const where = el("p", { class: "quiet" });
  const wrong = problem(`${listed}-problem`);
  let all: Line[] = [];
  const copyAll = copyButton(
    "Copy all",
    () =>
      `${listed}:\n${all
        .filter((each) => each.on)
        .map((each) => `  - ${each.line}\n`)
        .join("")}`,
    () => list,
    `${listed}-copy`,
  );
  const settle = listed === "edits" ? settlingOf(store) : null;
  const element = el(
    "section",
    { hidden: true },
    el("div", { class: "row" }, el("h3", { text: WORDS[listed].title }), copyAll),
    list,
    wrong,
    ...(settle ? [settle.element] : []),
    where,
  );
  const rows = keyed<Line>(
    list,
    (line) => String(line.key),
    () => row(store, listed),
  );
  store.connection.on(listed, (message) => {
    all = message.lines;
    element.hidden = all.length === 0;
    setText(where, WORDS[listed].where(message.file));
    write(wrong, message.problem && `not shown in this frame: ${message.problem}`);
    settle?.show(
      message.settling,
      all.some((each) => each.on),
    );
    counted(all.length);
    rows(all);
  });
  return element;
}

/** Return a button that simulates the agents again that edits affect, and the report. */
function settlingOf(store: Store): { element: HTMLElement; show: (now: Settling | undefined, possible: boolean) => void } {
  let on = true;
  const settle = button("Settle", () => store.connection.ask({ op: "settle", on }), {
    class: "small",
    title: "simulate the agents again that edits make overlap, or leave without a neighbour",
    test: "settle",
  });
  const report = el("p", { class: "quiet settle-report", test: "settle-report", role: "status" });
  return {
    element: el("div", {}, el("div", { class: "row settle" }, settle), report),
    show: (now, possible) => {
      on = !(now?.running || now?.settled);
      setText(settle, now?.running ? "Stop settling" : now?.settled ? "Remove settling" : "Settle");
      settle.disabled = on && !possible;
      setText(report, (now?.report ?? []).join("\n"));
      report.hidden = !now?.report.length;
    },
  };
}

function row(store: Store, listed: List): Row<Line> {
  let now: Line | null = null;
  const box = el("input", { type: "checkbox", test: "note-on" });
  const code = el("code", { test: "note-line" });
  const wrong = problem("note-problem");
  const ask = (action: "on" | "off" | "remove") =>
    now && store.connection.ask({ op: "line", list: listed, key: now.key, action });
  box.addEventListener("change", () => ask(box.checked ? "on" : "off"));
  const copy = copyButton(
    "Copy",
    () => now?.line ?? "",
    () => code,
    "note-copy",
  );
  const remove = button("✕", () => ask("remove"), { class: "small", test: "note-remove" });
  return {
    element: el("li", {}, el("label", {}, box, code), copy, remove, wrong),
    update: (line) => {
      now = line;
      box.checked = line.on;
      setText(code, line.line);
      copy.setAttribute("aria-label", `copy ${line.line}`);
      remove.setAttribute("aria-label", `remove ${line.line}`);
      write(wrong, line.problem && `switched off: ${line.problem}`);
    },
  };
}
