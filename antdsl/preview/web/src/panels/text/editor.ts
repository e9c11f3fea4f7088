// A read-only text: CodeMirror in a shadow root, where the content security policy allows its styles.

import { defaultKeymap } from "@codemirror/commands";
import { foldGutter, foldKeymap, syntaxHighlighting } from "@codemirror/language";
import { highlightSelectionMatches, search, searchKeymap } from "@codemirror/search";
import { EditorState, type StateEffect } from "@codemirror/state";
import { EditorView, drawSelection, highlightActiveLine, keymap, lineNumbers } from "@codemirror/view";
import type { Problem, Texts } from "../../protocol";
import { ant, colours, yaml } from "./colouring";
import { complain, marks, pointOut, setCosts } from "./marks";

type Text = Texts["texts"][number];

const MONO = "ui-monospace, SFMono-Regular, 'Cascadia Code', Menlo, Consolas, 'DejaVu Sans Mono', monospace";

const look = EditorView.theme({
  "&": { height: "100%", fontSize: "0.923rem", color: "var(--words)", backgroundColor: "var(--raised)" },
  "&.cm-focused": { outline: "2px solid var(--mark)", outlineOffset: "-2px" },
  ".cm-scroller": { fontFamily: MONO, lineHeight: "1.5" },
  ".cm-gutters": { backgroundColor: "var(--raised)", color: "var(--quiet)", border: "none" },
  ".cm-foldGutter": { width: "12px" },
  ".cm-activeLine, .cm-activeLineGutter": { backgroundColor: "transparent" },
  "&.cm-focused .cm-activeLine": { backgroundColor: "color-mix(in srgb, var(--mark) 8%, transparent)" },
  ".cm-cursor": { borderLeftColor: "var(--words)" },
  ".cm-selectionBackground, &.cm-focused > .cm-scroller > .cm-selectionLayer .cm-selectionBackground": {
    backgroundColor: "color-mix(in srgb, var(--mark) 28%, transparent)",
  },
  ".cm-selectionMatch": { backgroundColor: "color-mix(in srgb, var(--mark) 16%, transparent)" },
  ".cm-searchMatch": { backgroundColor: "color-mix(in srgb, var(--warn) 35%, transparent)" },
  ".cm-panels": { backgroundColor: "var(--ground)", color: "var(--words)" },
  ".cm-panels input, .cm-panels button": { font: "inherit" },
  ".pointed": { backgroundColor: "color-mix(in srgb, var(--mark) 20%, transparent)", boxShadow: "inset 3px 0 0 var(--mark)" },
  ".wrong": { textDecoration: "underline wavy 1.5px var(--warn)", textUnderlineOffset: "3px", textDecorationSkipInk: "none" },
  ".wrong.error": { textDecorationColor: "var(--bad)" },
  ".below": { padding: "1px 6px 4px 6px" },
  ".complaint": {
    fontFamily: "system-ui, sans-serif",
    padding: "3px 8px",
    borderLeft: "3px solid var(--warn)",
    backgroundColor: "color-mix(in srgb, var(--warn) 12%, transparent)",
    whiteSpace: "pre-wrap",
  },
  ".complaint.error": { borderLeftColor: "var(--bad)", backgroundColor: "color-mix(in srgb, var(--bad) 12%, transparent)" },
  ".complaint strong": { fontWeight: "600" },
  ".complaint span": { display: "block", color: "var(--quiet)" },
  ".cost": {
    display: "block",
    padding: "0 4px",
    textAlign: "right",
    color: "var(--words)",
    backgroundColor: "color-mix(in srgb, var(--warn) calc(var(--share) * 55%), transparent)",
  },
});

function fresh({ file: name, text, kind }: Text): EditorState {
  return EditorState.create({
    doc: text,
    extensions: [
      lineNumbers(),
      marks,
      foldGutter(),
      drawSelection(),
      highlightActiveLine(),
      highlightSelectionMatches(),
      search({ top: true }),
      syntaxHighlighting(colours),
      kind === "yaml" ? yaml : ant,
      keymap.of([...searchKeymap, ...foldKeymap, ...defaultKeymap]),
      EditorState.readOnly.of(true),
      EditorState.tabSize.of(2),
      EditorView.contentAttributes.of({ "aria-label": `${name}, read-only`, "aria-readonly": "true", "data-keys": "own" }),
      look,
    ],
  });
}

export class Editor {
  private readonly view: EditorView;
  private readonly cachedStates = new Map<string, { state: EditorState; scroll: StateEffect<unknown> | null }>();
  private file = "";

  constructor(place: HTMLElement) {
    const root = place.attachShadow({ mode: "open" });
    const inner = document.createElement("div");
    inner.style.height = "100%";
    root.append(inner);
    this.view = new EditorView({ root, parent: inner });
  }

  /** Replace the files. A changed file keeps its scroll position and folds, except in the changed part. */
  renew(texts: readonly Text[]): void {
    for (const file of this.cachedStates.keys()) if (!texts.some((each) => each.file === file)) this.cachedStates.delete(file);
    for (const each of texts) {
      const { file, text } = each;
      const old = file === this.file ? this.view.state : this.cachedStates.get(file)?.state;
      if (!old) {
        this.cachedStates.set(file, { state: fresh(each), scroll: null });
        continue;
      }
      const change = difference(old.doc.toString(), text);
      if (!change) continue;
      if (file === this.file) this.view.dispatch({ changes: change });
      else this.cachedStates.set(file, { state: old.update({ changes: change }).state, scroll: null });
    }
  }

  open(file: string): void {
    const next = this.cachedStates.get(file);
    if (file === this.file || !next) return;
    if (this.cachedStates.has(this.file))
      this.cachedStates.set(this.file, { state: this.view.state, scroll: this.view.scrollSnapshot() });
    this.file = file;
    this.view.setState(next.state);
    if (next.scroll) this.view.dispatch({ effects: next.scroll });
  }

  /** Highlight a line of the open file and scroll to it; null removes the highlight. */
  point(line: number | null): void {
    const { doc } = this.view.state;
    const effects: StateEffect<unknown>[] = [pointOut.of(line)];
    if (line !== null)
      effects.push(
        EditorView.scrollIntoView(doc.line(Math.min(Math.max(line, 1), doc.lines)).from, { y: "nearest", yMargin: 60 }),
      );
    this.view.dispatch({ effects });
  }

  complain(file: string, problems: readonly Problem[]): void {
    this.apply(file, complain.of(problems));
  }

  costs(file: string, byLine: ReadonlyMap<number, number>): void {
    this.apply(file, setCosts.of(byLine));
  }

  private apply(file: string, effects: StateEffect<unknown>): void {
    if (file === this.file) this.view.dispatch({ effects });
    else {
      const other = this.cachedStates.get(file);
      if (other) this.cachedStates.set(file, { ...other, state: other.state.update({ effects }).state });
    }
  }
}

/** Return the one range in which two texts differ; null if they are equal. */
function difference(old: string, now: string): { from: number; to: number; insert: string } | null {
  if (old === now) return null;
  let start = 0;
  while (start < old.length && start < now.length && old[start] === now[start]) start++;
  let end = 0;
  while (end < old.length - start && end < now.length - start && old.at(-1 - end) === now.at(-1 - end)) end++;
  return { from: start, to: old.length - end, insert: now.slice(start, now.length - end) };
}
