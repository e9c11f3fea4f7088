// Lines for changes by hand: a fresh run with these lines in its files gives the same result.

import type { Outcome } from "../../protocol";
import type { Store } from "../../store";
import { el, keyed, setText } from "../dom";
import { copyButton } from "./copying";

interface Line {
  key: string; // identifies the subject: a later line with the same key replaces this one
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
    this.element = el("section", { hidden: true }, el("h3", { text: "To keep these changes, write" }), list);
    this.show = keyed<Line>(
      list,
      (line) => line.key,
      () => this.row(),
    );
    store.connection.on("outcome", (outcome) => this.addOutcome(outcome));
    store.on("scene", () => this.forget(store));
  }

  private addOutcome(outcome: Outcome): void {
    if (!ABOUT.has(outcome.of) || !outcome.ok || !outcome.text) return;
    const key = /^set: \{([^:]+):/.exec(outcome.text)?.[1]?.trim() ?? `${outcome.file}\u0000${outcome.text}`;
    this.lines.set(key, { key, text: outcome.text, file: outcome.file });
    this.renew();
  }

  /** Remove lines that the files contain already, and lines for values that were reset. */
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
    const copy = copyButton(
      "Copy",
      () => code.textContent ?? "",
      () => code,
      "copy",
    );
    return {
      element: el("li", {}, el("span", {}, code, where), copy),
      update: (line: Line) => {
        setText(code, line.text);
        setText(where, line.file ? ` in ${line.file}` : "");
        copy.setAttribute("aria-label", `copy ${line.text}`);
      },
    };
  }
}
