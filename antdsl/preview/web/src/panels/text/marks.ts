// Marks in a text: the highlighted line, problems below their lines, and the cost of each line.

import { type Extension, RangeSet, StateEffect, StateField } from "@codemirror/state";
import { Decoration, type DecorationSet, EditorView, GutterMarker, WidgetType, gutter } from "@codemirror/view";
import type { Problem } from "../../protocol";
import { el } from "../dom";

export const pointOut = StateEffect.define<number | null>(); // a line, from 1
export const complain = StateEffect.define<readonly Problem[]>();
export const setCosts = StateEffect.define<ReadonlyMap<number, number>>(); // ms per frame, by line

class Complaint extends WidgetType {
  constructor(private readonly problem: Problem) {
    super();
  }

  override eq(other: Complaint): boolean {
    return other.problem.message === this.problem.message && other.problem.help === this.problem.help;
  }

  override toDOM(): HTMLElement {
    const { severity, message, help, code } = this.problem;
    const words = el("div", { class: `complaint ${severity}`, test: "complaint", title: code }, el("strong", { text: message }));
    if (help) words.append(el("span", { text: help }));
    return el("div", { class: "below" }, words); // an outer element: CodeMirror ignores margins when it places the next lines
  }
}

const pointed = StateField.define<DecorationSet>({
  create: () => Decoration.none,
  update(old, transaction) {
    let now = old.map(transaction.changes);
    for (const effect of transaction.effects) {
      if (!effect.is(pointOut)) continue;
      const line = effect.value;
      const there = line !== null && line >= 1 && line <= transaction.state.doc.lines;
      now = there
        ? Decoration.set([Decoration.line({ class: "pointed" }).range(transaction.state.doc.line(line).from)])
        : Decoration.none;
    }
    return now;
  },
  provide: (field) => EditorView.decorations.from(field),
});

const complaints = StateField.define<DecorationSet>({
  create: () => Decoration.none,
  update(old, transaction) {
    let now = old.map(transaction.changes);
    for (const effect of transaction.effects)
      if (effect.is(complain)) now = drawn(effect.value, transaction.state.doc.length, (at) => transaction.state.doc.lineAt(at));
    return now;
  },
  provide: (field) => EditorView.decorations.from(field),
});

function drawn(problems: readonly Problem[], length: number, lineAt: (at: number) => { to: number }): DecorationSet {
  const ranges = problems.flatMap((problem) => {
    const start = Math.min(problem.start, length);
    const end = Math.min(Math.max(problem.end, start), length);
    const below = Decoration.widget({ widget: new Complaint(problem), block: true, side: 1 }).range(
      lineAt(end > start ? end - 1 : start).to,
    );
    return end > start ? [Decoration.mark({ class: `wrong ${problem.severity}` }).range(start, end), below] : [below];
  });
  return Decoration.set(ranges, true);
}

class Cost extends GutterMarker {
  constructor(
    private readonly ms: number,
    private readonly share: number,
  ) {
    super();
  }

  override eq(other: Cost): boolean {
    return other.ms === this.ms && other.share === this.share;
  }

  override toDOM(): HTMLElement {
    const made = el("span", { class: "cost", text: this.ms >= 0.095 ? this.ms.toFixed(1) : this.ms.toFixed(2) });
    made.style.setProperty("--share", String(this.share));
    return made;
  }
}

const costs = StateField.define<RangeSet<GutterMarker>>({
  create: () => RangeSet.empty,
  update(old, transaction) {
    let now = old.map(transaction.changes);
    for (const effect of transaction.effects) {
      if (!effect.is(setCosts)) continue;
      const { doc } = transaction.state;
      const dearest = Math.max(...effect.value.values(), 1e-9);
      const lines = [...effect.value]
        .filter(([line, ms]) => line >= 1 && line <= doc.lines && ms >= 0.005)
        .sort((a, b) => a[0] - b[0]);
      now = RangeSet.of(lines.map(([line, ms]) => new Cost(ms, ms / dearest).range(doc.line(line).from)));
    }
    return now;
  },
});

const costGutter = gutter({ class: "costs", markers: (view) => view.state.field(costs), renderEmptyElements: false });

export const marks: Extension = [pointed, complaints, costs, costGutter];
