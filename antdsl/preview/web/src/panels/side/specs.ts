// The state of the specs: whether each holds up to now, since which frame it is checked, and where it failed.

import type { Specs } from "../../protocol";
import type { Store } from "../../store";
import { el, keyed, type Row, setText } from "../dom";
import { seek } from "../playing";

type Spec = Specs["specs"][number];

export function specs(store: Store): HTMLElement {
  const list = el("ul", { class: "specs", test: "specs" });
  const section = el("section", { hidden: true }, el("h3", { text: "Specs so far" }), list);
  const rows = keyed<Spec>(
    list,
    (spec) => spec.name,
    () => row(store),
  );
  store.connection.on("specs", (message) => {
    section.hidden = message.specs.length === 0;
    rows(message.specs);
  });
  return section;
}

function row(store: Store): Row<Spec> {
  let now: Spec | null = null;
  const name = el("span");
  const verdict = el("span", { class: "verdict" });
  const words = el("p");
  const go = el("button", { type: "button", class: "link", on: { click: () => now && show(store, now) } });
  const element = el("li", {}, verdict, name, words, go);
  return {
    element,
    update: (spec) => {
      now = spec;
      element.className = spec.holds === null ? "" : spec.holds ? "holds" : "fails";
      setText(name, spec.name);
      setText(verdict, spec.holds === null ? "not judged" : spec.holds ? "holds" : "fails");
      const since = spec.holds !== null && spec.since !== null ? `judged from frame ${spec.since} on` : "";
      setText(words, [spec.message, since].filter(Boolean).join(" · "));
      go.hidden = spec.frame === null;
      setText(go, spec.frame === null ? "" : `show frame ${spec.frame}`);
    },
  };
}

function show(store: Store, spec: Spec): void {
  if (spec.frame !== null) seek(store, spec.frame);
  if (spec.agents.length)
    store.set(
      "selected",
      spec.agents.map((id) => ({ species: spec.species, id })),
    );
}
