// The lines that stand for what was changed by hand: with them in the files a fresh run does the same.

import type { Outcome } from "../../protocol";
import type { Store } from "../../store";
import { button, el, keyed, say } from "../dom";

interface Line {
  key: string; // what it is about: a later line about the same takes its place
  text: string;
  file: string;
}

const ABOUT = new Set(["set", "layer", "field"]);

export class Lines {
  readonly element: HTMLElement;
  private readonly lines = new Map<string, Line>();
  private readonly show: (lines: readonly Line[]) => void;

  constructor(store: Store) {
    const list = el("ul", { class: "lines", test: "lines" });
    this.element = el("section", { hidden: true }, el("h3", { text: "To have the same for good, write" }), list);
    this.show = keyed<Line>(
      list,
      (line) => line.key,
      () => this.row(),
    );
    store.connection.on("outcome", (outcome) => this.heard(outcome));
    store.on("scene", () => this.forget(store));
  }

  private heard(outcome: Outcome): void {
    if (!ABOUT.has(outcome.of) || !outcome.ok || !outcome.text) return;
    const key = /^set: \{([^:]+):/.exec(outcome.text)?.[1]?.trim() ?? `${outcome.file}\u0000${outcome.text}`;
    this.lines.set(key, { key, text: outcome.text, file: outcome.file });
    this.renew();
  }

  /** What the files have by now, or what was put back, needs no line any more. */
  private forget(store: Store): void {
    const scene = store.now.scene;
    for (const param of scene?.params ?? []) if (param.value === param.written) this.lines.delete(param.name);
    for (const field of scene?.fields ?? []) if (field.on) this.lines.delete(`${field.name}.limit`);
    const on = new Set(
      scene?.species.flatMap((each) => each.layers.filter((layer) => layer.on).map((layer) => `# ${layer.text}`)),
    );
    for (const [key, line] of this.lines) if (on.has(line.text)) this.lines.delete(key);
    this.renew();
  }

  private renew(): void {
    this.element.hidden = this.lines.size === 0;
    this.show([...this.lines.values()]);
  }

  private row() {
    const code = el("code", { test: "line" });
    const where = el("span", { class: "quiet" });
    const copy = button("Copy", () => this.copy(code, copy), { class: "small", test: "copy" });
    return {
      element: el("li", {}, el("span", {}, code, where), copy),
      update: (line: Line) => {
        say(code, line.text);
        say(where, line.file ? ` in ${line.file}` : "");
        copy.setAttribute("aria-label", `copy ${line.text}`);
      },
    };
  }

  /** To the clipboard; where a browser has none for this page, the text is marked, for the copy key. */
  private copy(code: HTMLElement, copied: HTMLButtonElement): void {
    const done = navigator.clipboard?.writeText(code.textContent ?? "");
    const mark = () => getSelection()?.selectAllChildren(code);
    if (done) void done.then(() => this.said(copied), mark);
    else mark();
  }

  private said(copied: HTMLButtonElement): void {
    say(copied, "Copied");
    setTimeout(() => say(copied, "Copy"), 1500);
  }
}
