// Notes for agents: a verb from the server's table, its keys, the line to write, and the notes of the run.

import { type Directed, nameAgents, type Verb } from "../../directing";
import type { Store } from "../../store";
import { el, setText, throttled } from "../dom";
import type { Panel, Shown } from "../side";
import { copyButton } from "./copying";
import { type Fields, labelled, makeFields, problem, write } from "./fields";
import { notes } from "./notes";

const EVERY = 250; // ms between two checks while the user writes
const NONE = "Select agents in the view, or write a crowd line or a species.";
const TOO_MANY = "Too many agents for a list: write a crowd line or a species, and conditions below.";

export const direct: Panel = (store, place, shown) => {
  const form = new NoteForm(store, shown);
  place.append(form.hint, form.element, notes(store, shown));
};

class NoteForm {
  readonly hint = el("p", { class: "note", text: NONE, test: "direct-hint" });
  readonly element: HTMLFormElement;
  private readonly agents = el("input", {
    type: "text",
    spellcheck: "false",
    maxlength: 4000,
    list: "direct-agents",
    test: "direct-agents",
  });
  private readonly names = el("datalist", { id: "direct-agents" });
  private readonly verbs = el("select", { test: "direct-verb" });
  private readonly about = el("p", { class: "help" });
  private readonly help = el("p", { class: "help of-key" }); // of one key, where no change of the focus moves other elements
  private readonly wrong = problem("direct-wrong-agents");
  private readonly whole = problem("direct-wrong");
  private readonly places = el("div", { test: "direct-fields" });
  private readonly line = el("code", { test: "direct-line" });
  private readonly apply = el("button", { type: "submit", text: "Apply", test: "direct-apply" });
  private readonly copy = copyButton(
    "Copy line",
    () => this.line.textContent ?? "",
    () => this.line,
    "direct-copy",
  );
  private fields: Fields | null = null;
  private table = ""; // the verbs and names for which the form was made
  private readonly check = throttled(EVERY, () => this.text && this.shown.shown() && this.send(false));

  constructor(
    private readonly store: Store,
    private readonly shown: Shown,
  ) {
    this.element = el(
      "form",
      { class: "direct" },
      el("div", { class: "field" }, labelled("Agents", this.agents), this.names, this.wrong),
      el("div", { class: "field" }, labelled("Note", this.verbs), this.about),
      this.places,
      el(
        "div",
        { class: "finish" },
        this.help,
        this.whole,
        el("p", { class: "line" }, this.line),
        el("div", { class: "row" }, this.apply, this.copy),
      ),
    );
    this.listen();
  }

  private listen(): void {
    this.element.addEventListener("submit", (event) => {
      event.preventDefault();
      this.send(true);
    });
    this.agents.addEventListener("input", () => this.renew());
    this.verbs.addEventListener("change", () => this.choose());
    this.shown.onVisibilityChange(() => (this.shown.shown() ? this.renew() : this.store.set("picking", null)));
    this.store.on("selected", () => this.take());
    this.store.on("status", () => this.fields?.setFrame() && this.renew());
    this.store.on("picking", () => this.fields?.showPicking());
    this.store.on("verbs", () => this.fill());
    this.store.connection.on("directed", (message) => this.show(message));
  }

  private get text(): string {
    return this.agents.value.trim();
  }

  private get verb(): Verb | undefined {
    return this.store.now.verbs?.notes.find((each) => each.verb === this.verbs.value);
  }

  /** Take the agents from the selection. Without one, what was written or selected before stays. */
  private take(): void {
    const { selected, verbs } = this.store.now;
    if (!selected.length) return;
    this.agents.value = nameAgents(selected, verbs?.lines ?? []);
    setText(this.hint, this.text ? NONE : TOO_MANY);
    this.renew();
  }

  /** Fill in the server's table of verbs, and the names of agents. */
  private fill(): void {
    const { verbs, scene } = this.store.now;
    const now = JSON.stringify([verbs?.notes, verbs?.lines]);
    if (!verbs || now === this.table) return;
    this.table = now;
    const before = this.verbs.value;
    this.verbs.replaceChildren(...verbs.notes.map(({ verb }) => el("option", { value: verb, text: verb })));
    if (verbs.notes.some((each) => each.verb === before)) this.verbs.value = before;
    const names = [...verbs.lines, ...(scene?.species ?? [])].map((each) => each.name);
    this.names.replaceChildren(...names.map((value) => el("option", { value })));
    this.choose();
  }

  private choose(): void {
    const { verb } = this;
    this.store.set("picking", null);
    setText(this.about, verb?.help ?? "");
    setText(this.help, "");
    this.fields = verb
      ? makeFields(
          this.store,
          verb,
          () => this.renew(),
          (help) => setText(this.help, help),
        )
      : null;
    this.places.replaceChildren(...(this.fields?.elements ?? []));
    this.show(null);
    this.renew();
  }

  private renew(): void {
    this.hint.hidden = Boolean(this.text);
    this.copy.disabled = true; // until the server has written the line
    if (!this.text) this.show(null);
    this.check();
  }

  private send(applied: boolean): void {
    if (!this.verb) return;
    const values = this.fields?.values() ?? {};
    this.store.connection.ask({ op: "direct", verb: this.verb.verb, agents: this.text, values, apply: applied });
  }

  private show(answer: Directed | null): void {
    const words = (key: string) =>
      (answer?.problems ?? [])
        .filter((each) => each.key === key)
        .map((each) => [each.message, each.help].filter(Boolean).join(": "))
        .join("\n");
    write(this.wrong, words("agents"));
    write(this.whole, words(""));
    this.fields?.showProblems(words);
    setText(this.line, answer?.line ?? "");
    this.apply.disabled = this.copy.disabled = !answer?.ok;
  }
}
