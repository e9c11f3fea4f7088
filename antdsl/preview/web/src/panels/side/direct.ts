// Notes and edits for agents: a verb from the server's tables, its keys, the line to write, and the lines of this run.

import { type Directed, type List, nameAgents, type Verb } from "../../directing";
import type { Store } from "../../store";
import { el, setText, throttled } from "../dom";
import type { Panel, Shown } from "../side";
import { copyButton } from "./copying";
import { type Fields, labelled, makeFields, problem, write } from "./fields";
import { lines } from "./written";

const LISTS: readonly List[] = ["notes", "edits"];
const ABOUT: Record<List, string> = {
  notes: "A note changes the run: it is simulated again.",
  edits: "An edit changes the simulated frames, as `antdsl edit` does with a cache. The run stays as it is.",
};
const LIST_NAMES: Record<List, string> = { notes: "note", edits: "edit" };
const EVERY = 250; // ms between two checks while the user writes
const NAMED = { agents: "Agents", cache: "Cache" };
const NONE = "Select agents in the view, or write a crowd line or a species.";
const TOO_MANY = "Too many agents for a list: write a crowd line or a species, and conditions below.";

export const direct: Panel = (store, place, shown) => {
  const form = new LineForm(store, shown);
  const counts: Record<List, number> = { notes: 0, edits: 0 };
  const written = LISTS.map((list) =>
    lines(store, list, (count) => {
      counts[list] = count;
      shown.mark(counts.notes + counts.edits ? String(counts.notes + counts.edits) : "");
    }),
  );
  place.append(form.hint, form.element, ...written);
};

class LineForm {
  readonly hint = el("p", { class: "note", text: NONE, test: "direct-hint" });
  readonly element: HTMLFormElement;
  private readonly agents = el("input", {
    type: "text",
    spellcheck: "false",
    maxlength: 4000,
    list: "direct-agents",
    test: "direct-agents",
  });
  private readonly names = el("datalist", { id: "direct-agents", test: "direct-choices-agents" });
  private readonly named = labelled(NAMED.agents, this.agents);
  private readonly written: Record<Verb["kind"], string> = { agents: "", cache: "" }; // the values of verbs of each kind
  private valueKind: Verb["kind"] = "agents";
  private readonly lists = new Map(
    LISTS.map((list) => [
      list,
      el("input", { type: "radio", name: "direct-list", value: list, checked: list === "notes", test: `direct-list-${list}` }),
    ]),
  );
  private readonly kind = el("p", { class: "help" });
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
  private agentNames: string[] = [];
  private table = ""; // the verbs and names for which the form was made
  private readonly check = throttled(EVERY, () => this.text && this.shown.shown() && this.send(false));

  constructor(
    private readonly store: Store,
    private readonly shown: Shown,
  ) {
    this.element = el(
      "form",
      { class: "direct" },
      el("div", { class: "field" }, this.named, this.names, this.wrong),
      el(
        "fieldset",
        { class: "lists" },
        el("legend", { text: "Kind" }),
        ...LISTS.map((list) => el("label", {}, this.lists.get(list), el("span", { text: LIST_NAMES[list] }))),
        this.kind,
      ),
      el("div", { class: "field" }, labelled("Verb", this.verbs), this.about),
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
    for (const each of this.lists.values()) each.addEventListener("change", () => this.chooseList());
    this.shown.onVisibilityChange(() => (this.shown.shown() ? this.renew() : this.store.set("picking", null)));
    this.store.on("selected", () => this.take());
    this.store.on("status", () => this.fields?.setFrame() && this.renew());
    this.store.on("picking", () => this.fields?.showPicking());
    this.store.on("verbs", () => this.fill());
    this.store.connection.on("directed", (message) => message.list === this.list && this.show(message));
  }

  private get text(): string {
    return this.agents.value.trim();
  }

  private get list(): List {
    return LISTS.find((list) => this.lists.get(list)?.checked) ?? "notes";
  }

  private get verb(): Verb | undefined {
    return this.store.now.verbs?.[this.list].find((each) => each.verb === this.verbs.value);
  }

  /** Take the agents from the selection. Without one, what was written or selected before stays. */
  private take(): void {
    const { selected, verbs } = this.store.now;
    if (!selected.length) return;
    if (this.valueKind !== "agents") {
      this.written.agents = nameAgents(selected, verbs?.lines ?? []);
      return;
    }
    this.agents.value = nameAgents(selected, verbs?.lines ?? []);
    setText(this.hint, this.text ? NONE : TOO_MANY);
    this.renew();
  }

  /** Fill in the server's table of verbs, and the names of agents. */
  private fill(): void {
    const { verbs, scene } = this.store.now;
    const now = JSON.stringify([verbs?.notes, verbs?.edits, verbs?.lines]);
    if (!verbs || now === this.table) return;
    this.table = now;
    this.agentNames = [...verbs.lines, ...(scene?.species ?? [])].map((each) => each.name);
    this.chooseList();
  }

  /** Ask for the verb's own value: agents, or a cache. What was written for verbs of the other kind comes back with them. */
  private setValueKind(verb: Verb | undefined): void {
    const kind = verb?.kind ?? "agents";
    const names = kind === "agents" ? this.agentNames : (verb?.choices ?? []);
    this.names.replaceChildren(...names.map((value) => el("option", { value })));
    if (kind === this.valueKind) return;
    this.written[this.valueKind] = this.agents.value;
    this.valueKind = kind;
    this.agents.value = this.written[kind];
    this.agents.placeholder = kind === "cache" ? (verb?.example ?? "") : "";
    setText(this.named.querySelector(".name") as HTMLElement, NAMED[kind]);
  }

  /** Fill in the verbs of the chosen list. A verb of both lists stays. */
  private chooseList(): void {
    const verbs = this.store.now.verbs?.[this.list] ?? [];
    const before = this.verbs.value;
    this.verbs.replaceChildren(...verbs.map(({ verb }) => el("option", { value: verb, text: verb })));
    if (verbs.some((each) => each.verb === before)) this.verbs.value = before;
    setText(this.kind, ABOUT[this.list]);
    this.choose();
  }

  private choose(): void {
    const { verb } = this;
    this.store.set("picking", null);
    this.setValueKind(verb);
    setText(this.about, verb?.help ?? "");
    setText(this.help, "");
    this.fields = verb
      ? makeFields(
          this.store,
          this.list,
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
    this.hint.hidden = Boolean(this.text) || this.valueKind !== "agents";
    this.copy.disabled = true; // until the server has written the line
    if (!this.text) this.show(null);
    this.check();
  }

  private send(applied: boolean): void {
    if (!this.verb) return;
    const values = this.fields?.values() ?? {};
    const { list, text: agents } = this;
    this.store.connection.ask({ op: "direct", list, verb: this.verb.verb, agents, values, apply: applied });
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
    this.fields?.setChoices(answer?.choices ?? {});
    setText(this.line, answer?.line ?? "");
    this.apply.disabled = this.copy.disabled = !answer?.ok;
  }
}
