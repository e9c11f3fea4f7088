// Breakpoints: an agent enters a state, a condition becomes true, a spec fails, or a value is faulty.

import type { Break } from "../../protocol";
import type { Store } from "../../store";
import { button, el, keyed, type Row, setText } from "../dom";
import type { Panel } from "../side";
import { specs } from "./specs";

export const breaks: Panel = (store, place, shown) => {
  const all: Break[] = [];
  const list = el("ul", { class: "breaks", test: "breaks" });
  const fired = el("p", { class: "fired", test: "fired", hidden: true });
  const unfit = new Map<string, string>(); // by breakpoint as JSON: why it does not fit the program
  const none = el("p", { class: "note", text: "No breakpoints. After a stop, press play to continue." });
  const rows = keyed<Break>(
    list,
    (each) => JSON.stringify(each),
    () => row(unfit, (gone) => change(all.filter((each) => JSON.stringify(each) !== JSON.stringify(gone)))),
  );
  const show = (now: Break[]) => {
    all.splice(0, all.length, ...now);
    rows(all);
    none.hidden = all.length > 0;
    shown.mark(all.length ? String(all.length) : "");
  };
  const change = (now: Break[]) => {
    show(now);
    store.connection.ask({ op: "breaks", breaks: [...all] }, true);
  };
  let pending: { made: string; done: ((wrong: string) => void) | undefined } | null = null; // a breakpoint without an answer yet
  const add: Add = (made, done) => {
    if (all.some((each) => JSON.stringify(each) === JSON.stringify(made))) return done?.("");
    pending = { made: JSON.stringify(made), done };
    store.connection.ask({ op: "breaks", breaks: [...all], tried: made });
  };
  place.append(
    fired,
    list,
    none,
    stateForm(store, add),
    conditionForm(store, add),
    specForm(store, add),
    faultForm(add),
    specs(store),
  );
  store.on("status", () => {
    const by = store.now.status?.paused_by ?? "";
    fired.hidden = !by;
    setText(fired, by && `stopped: ${by}`);
    selectPaused(store);
  });
  store.connection.on("breaks", (message) => {
    // all breakpoints, of all pages; sent again after changes of the program
    unfit.clear();
    for (const each of message.breaks) unfit.set(JSON.stringify(each.made), each.why);
    show(message.breaks.map((each) => each.made));
    store.connection.remember({ op: "breaks", breaks: [...all] });
    if (pending && all.some((each) => JSON.stringify(each) === pending?.made)) answer("");
  });
  store.connection.on(
    "refused",
    (message) => message.of === "breaks" && answer([message.message, message.help].filter(Boolean).join(": ")),
  );
  const answer = (wrong: string) => {
    pending?.done?.(wrong);
    pending = null;
  };
};

/** Add a breakpoint. `done` receives an error message, or an empty string. */
type Add = (made: Break, done?: (wrong: string) => void) => void;

let handledStop = ""; // the last stop; its agents are selected only once, so that users can select others

function selectPaused(store: Store): void {
  const status = store.now.status;
  const about = status?.paused_agents;
  const key = about && status ? `${status.frame} ${status.paused_by}` : "";
  if (key && key !== handledStop && about)
    store.set(
      "selected",
      about.agents.map((id) => ({ species: about.species, id })),
    );
  handledStop = key;
}

function words(each: Break): string {
  switch (each.kind) {
    case "state":
      return `${each.species} enters ${each.state}${each.machine === "main" ? "" : ` (${each.machine})`}`;
    case "condition":
      return `when ${each.text}`;
    case "spec":
      return `spec "${each.spec}" fails`;
    case "fault":
      return "a value is faulty";
  }
}

function row(unfit: ReadonlyMap<string, string>, remove: (gone: Break) => void): Row<Break> {
  let now: Break | null = null;
  const text = el("span");
  const misfit = el("p", { class: "misfit", test: "break-misfit", role: "alert" });
  const gone = button("✕", () => now && remove(now), { class: "small" });
  return {
    element: el("li", {}, el("span", { class: "dot" }), text, gone, misfit),
    update: (each) => {
      now = each;
      setText(text, words(each));
      const why = unfit.get(JSON.stringify(each));
      misfit.hidden = !why;
      setText(misfit, why ? `does not fit this program: ${why}` : "");
      gone.setAttribute("aria-label", `remove breakpoint: ${words(each)}`);
    },
  };
}

function form(
  title: string,
  test: string,
  add: (showError: (wrong: string) => void) => void,
  ...children: Node[]
): HTMLFormElement {
  const wrong = el("p", { class: "bad-note", test: `${test}-wrong`, role: "alert", hidden: true });
  const showError = (what: string) => {
    wrong.hidden = !what;
    setText(wrong, what);
  };
  const made = el(
    "form",
    { class: "add", test },
    el("h3", { text: title }),
    el("div", { class: "row" }, ...children, el("button", { type: "submit", text: "Add" })),
    wrong,
  );
  made.addEventListener("input", () => showError(""));
  made.addEventListener("submit", (event) => {
    event.preventDefault();
    add(showError);
  });
  return made;
}

function stateForm(store: Store, add: Add): HTMLElement {
  const select = el("select", { "aria-label": "State", test: "break-state" });
  let options: { words: string; made: Break }[] = [];
  const made = form(
    "An agent enters a state",
    "break-state-form",
    () => options[select.selectedIndex] && add((options[select.selectedIndex] as { made: Break }).made),
    select,
  );
  let seen = "";
  store.on("scene", () => {
    const species = store.now.scene?.species ?? [];
    options = species.flatMap((each) =>
      each.machines.flatMap((machine) =>
        machine.states.map((state) => ({
          words: [species.length > 1 && each.name, each.machines.length > 1 && machine.name, state].filter(Boolean).join(" · "),
          made: { kind: "state" as const, species: each.name, machine: machine.name, state },
        })),
      ),
    );
    const now = JSON.stringify(options);
    made.hidden = options.length === 0;
    if (now === seen) return;
    seen = now;
    const before = select.value;
    select.replaceChildren(...options.map((each) => el("option", { text: each.words })));
    if (before) select.value = before;
  });
  return made;
}

function conditionForm(store: Store, add: Add): HTMLElement {
  const field = el("input", {
    type: "text",
    maxlength: 2000,
    spellcheck: "false",
    "aria-label": "Condition, as in a spec",
    test: "break-condition",
  });
  store.on("scene", () => {
    const state = store.now.scene?.species[0]?.machines[0]?.states.at(-1);
    field.placeholder = state ? `count(state == ${state}) > 10` : "";
  });
  return form(
    "A condition becomes true",
    "break-condition-form",
    (showError) => {
      const text = field.value.trim();
      if (!text) return;
      add({ kind: "condition", text }, (wrong) => {
        showError(wrong);
        if (!wrong && field.value.trim() === text) field.value = "";
      });
    },
    field,
  );
}

function specForm(store: Store, add: Add): HTMLElement {
  const select = el("select", { "aria-label": "Spec", test: "break-spec" });
  const made = form(
    "A spec fails",
    "break-spec-form",
    (showError) => select.value && add({ kind: "spec", spec: select.value }, showError),
    select,
  );
  let seen = "";
  store.on("scene", () => {
    const names = store.now.scene?.specs ?? [];
    made.hidden = names.length === 0;
    const now = names.join("\n");
    if (now !== seen) select.replaceChildren(...names.map((value) => el("option", { value, text: value })));
    seen = now;
  });
  return made;
}

function faultForm(add: Add): HTMLElement {
  return form(
    "A value is faulty",
    "break-fault-form",
    () => add({ kind: "fault" }),
    el("span", { class: "quiet", text: "not a number, or far outside" }),
  );
}
