// The notes that pages added to the run: each can be switched off, copied and removed; and all of them as text for the scene.

import type { Note } from "../../directing";
import type { Store } from "../../store";
import { button, el, keyed, type Row, setText } from "../dom";
import type { Shown } from "../side";
import { copyButton } from "./copying";

export function notes(store: Store, shown: Shown): HTMLElement {
  const list = el("ul", { class: "lines notes", test: "notes" });
  const where = el("p", { class: "quiet" });
  let all: Note[] = [];
  const copyAll = copyButton(
    "Copy all",
    () =>
      `notes:\n${all
        .filter((each) => each.on)
        .map((each) => `  - ${each.line}\n`)
        .join("")}`,
    () => list,
    "notes-copy",
  );
  const element = el(
    "section",
    { hidden: true },
    el("div", { class: "row" }, el("h3", { text: "Notes of this run" }), copyAll),
    list,
    where,
  );
  const rows = keyed<Note>(
    list,
    (note) => String(note.key),
    () => row(store),
  );
  store.connection.on("notes", (message) => {
    all = message.notes;
    element.hidden = all.length === 0;
    setText(where, `To keep them, write them below \`notes:\` in ${message.file}.`);
    shown.mark(all.length ? String(all.length) : "");
    rows(all);
  });
  return element;
}

function row(store: Store): Row<Note> {
  let now: Note | null = null;
  const box = el("input", { type: "checkbox", test: "note-on" });
  const code = el("code", { test: "note-line" });
  const problem = el("p", { class: "bad-note", hidden: true });
  const ask = (action: "on" | "off" | "remove") => now && store.connection.ask({ op: "note", key: now.key, action });
  box.addEventListener("change", () => ask(box.checked ? "on" : "off"));
  const copy = copyButton(
    "Copy",
    () => now?.line ?? "",
    () => code,
    "note-copy",
  );
  const remove = button("✕", () => ask("remove"), { class: "small", test: "note-remove" });
  return {
    element: el("li", {}, el("label", {}, box, code), copy, remove, problem),
    update: (note) => {
      now = note;
      box.checked = note.on;
      setText(code, note.line);
      copy.setAttribute("aria-label", `copy ${note.line}`);
      remove.setAttribute("aria-label", `remove ${note.line}`);
      problem.hidden = !note.problem;
      setText(problem, note.problem && `switched off: ${note.problem}`);
    },
  };
}
