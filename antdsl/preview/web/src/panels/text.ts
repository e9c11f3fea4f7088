// The texts of the program and the scene, read-only. Users edit them in their own editor.

import type { Problem } from "../protocol";
import type { Store } from "../store";
import { el, keyed, setText } from "./dom";
import { Tabs } from "./tabs";
import { Editor } from "./text/editor";
import { same, shortName } from "./text/files";

export function text(store: Store, place: HTMLElement): void {
  const host = el("div", { class: "editor", id: "editor", role: "tabpanel", test: "editor" });
  const editor = new Editor(host);
  const tabs = new Tabs(
    "Files",
    "file",
    () => "editor",
    (file) => {
      editor.open(file);
      host.setAttribute("aria-label", file);
      host.dataset.file = file;
      point(store, editor, file);
    },
  );
  const list = el("ul", { class: "problems", test: "problems", "aria-label": "Problems" });
  const rows = keyed<Problem>(list, problemKey, () => problemRow(store));
  place.append(tabs.list, host, list);

  store.on("texts", () => {
    const texts = store.now.texts?.texts ?? [];
    editor.renew(texts);
    const fresh = tabs.now === "";
    tabs.renew(
      texts.map(({ file, kind }) => ({
        id: file,
        label: shortName(file),
        title: kind === "library" ? `${file} (library)` : file,
      })),
    );
    const program = texts.find((each) => each.kind === "ant");
    if (fresh && program) tabs.chooseForUser(program.file);
    showProblems(store, editor, tabs);
  });
  store.on("problems", () => {
    const problems = store.now.problems?.problems ?? [];
    list.hidden = problems.length === 0;
    rows(problems);
    showProblems(store, editor, tabs);
    const to = store.now.goto;
    if (to?.mistake && !problems.some((each) => each.file !== null && same(each.file, to.file) && each.line === to.line))
      store.set("goto", null);
  });
  list.hidden = true;
  store.on("goto", () => {
    const to = store.now.goto;
    if (!to) return editor.point(null);
    const file = (store.now.texts?.texts ?? []).find((each) => same(each.file, to.file))?.file;
    if (!file) return;
    if (file !== tabs.now) tabs.choose(file);
    editor.point(to.line);
  });
  store.on("profile", () => {
    const lines = store.now.profile?.lines ?? [];
    for (const { file } of store.now.texts?.texts ?? []) {
      editor.costs(file, new Map(lines.filter((each) => same(each.file, file)).map((each) => [each.line, each.ms])));
    }
  });
}

function point(store: Store, editor: Editor, file: string): void {
  const to = store.now.goto;
  if (to && same(to.file, file)) editor.point(to.line);
}

function showProblems(store: Store, editor: Editor, tabs: Tabs): void {
  for (const { file } of store.now.texts?.texts ?? []) {
    const its = (store.now.problems?.problems ?? []).filter((each) => each.file !== null && same(each.file, file));
    editor.complain(file, its);
    tabs.mark(file, its.length ? String(its.length) : "");
  }
}

function problemKey(problem: Problem): string {
  return [problem.file, problem.code, problem.line, problem.column, problem.message].join("\u0000");
}

function problemRow(store: Store) {
  const where = el("span", { class: "where" });
  const words = el("span");
  let now: Problem | null = null;
  const button = el(
    "button",
    {
      type: "button",
      on: { click: () => now?.file && store.set("goto", { file: now.file, line: now.line, mistake: true }) },
    },
    where,
    words,
  );
  const element = el("li", {}, button);
  return {
    element,
    update: (problem: Problem) => {
      now = problem;
      element.className = problem.severity;
      setText(where, problem.file ? `${shortName(problem.file)}:${problem.line}` : "");
      setText(words, problem.message);
      button.title = [problem.message, problem.help, `(${problem.code})`].filter(Boolean).join("\n");
    },
  };
}
