// What the view displays: colours, fields, flows, marks of the selected agent, camera. Requests the data for it from the server.

import { type Ask, MOST_PLANNED } from "../../protocol";
import { NATURAL, type Shared, type Store } from "../../store";
import { button, el, keyed, type Row, setText } from "../dom";
import { fullOf } from "../../view/scales";
import type { Panel } from "../side";

type Toggle = "trails" | "paths" | "feelers" | "neighbours" | "curvesShown" | "glass";
const TOGGLES: [Toggle, string][] = [
  ["trails", "trails"],
  ["paths", "planned paths: the next 2 seconds"],
  ["feelers", "feelers of the selected agent, and what they hit"],
  ["neighbours", "neighbours that it observed"],
  ["curvesShown", "curves of the scene"],
  ["glass", "transparent solids, stones and shapes"],
];
const CAMERAS: [Shared["camera"], string, string][] = [
  ["orbit", "free", "turn with the pointer"],
  ["follow", "follow", "stay with the selected agent"],
  ["ride", "ride", "sit on the selected agent"],
];
const KEYS: [string, string][] = [
  ["n p", "the next ant, the previous ant"],
  ["g f c", "near the selected ant, the whole ground, the scene's camera"],
  ["h v", "all ants; all ants from above"],
  ["1 2 3", "free, follow, ride"],
  ["s", "colours of states, natural colours"],
  ["t a x", "trails; planned paths; see through solids and stones"],
  ["arrows + −", "turn, come closer"],
  ["Esc", "clear the selection"],
  ["shift", "with a click: add an agent; dragged: select all in a box"],
  ["space , .", "play or pause; one frame back or forward"],
];

export const look: Panel = (store, place) => {
  place.append(
    colouring(store),
    camera(store),
    toggles(store),
    shownNames(store, "fields", "Fields on the ground"),
    shownNames(store, "flows", "Flows as arrows"),
    keys(),
  );
  askOnChange(store);
};

function colouring(store: Store): HTMLElement {
  const select = el("select", { test: "colour", id: "colour" });
  select.addEventListener("change", () => store.set("colour", select.value));
  let options = "";
  store.on(["scene", "colour"], () => {
    const all = colours(store);
    const now = all.map(([value, words]) => `${value}\u0000${words}`).join("\n");
    if (now !== options) select.replaceChildren(...all.map(([value, words]) => el("option", { value, text: words })));
    options = now;
    select.value = store.now.colour;
  });
  return el("section", { class: "row" }, el("label", { for: "colour", text: "Colours" }), select);
}

/** Return the options: natural colours, state, state of each machine (if several), speed, all attributes of all species without repeats. */
function colours(store: Store): [string, string][] {
  const species = store.now.scene?.species ?? [];
  const machines = new Set(
    species.filter((each) => each.machines.length > 1).flatMap((each) => each.machines.map((machine) => machine.name)),
  );
  const attributes = new Map(
    species.flatMap((each) => each.attributes.map((attribute) => [attribute.name, attribute.unit] as const)),
  );
  attributes.delete("speed");
  return [
    [NATURAL, "natural"],
    ["state", "by state"],
    ...[...machines].map((name): [string, string] => [`state/${name}`, `by state of ${name}`]),
    ["speed", "by speed (mm/s)"],
    ...[...attributes].map(([name, unit]): [string, string] => [name, unit ? `by ${name} (${unit})` : `by ${name}`]),
  ];
}

function camera(store: Store): HTMLElement {
  const buttons = CAMERAS.map(
    ([name, words, title]) => [name, button(words, () => store.set("camera", name), { title, test: `camera-${name}` })] as const,
  );
  const show = () => {
    for (const [name, each] of buttons) each.setAttribute("aria-pressed", String(store.now.camera === name));
  };
  store.on("camera", show);
  show();
  return el(
    "section",
    { class: "row" },
    el("span", { text: "Camera" }),
    el("span", { class: "segments", role: "group", "aria-label": "Camera" }, ...buttons.map(([, each]) => each)),
  );
}

/** List the keys of the view. */
function keys(): HTMLElement {
  const rows = KEYS.flatMap(([key, words]) => [el("dt", { class: "mono", text: key }), el("dd", { text: words })]);
  return el(
    "section",
    { test: "keys" },
    el("h3", { text: "Keys, after a click into the view" }),
    el("dl", { class: "keys" }, ...rows),
  );
}

function toggles(store: Store): HTMLElement {
  const section = el("section", {}, el("h3", { text: "Shown" }));
  for (const [key, words] of TOGGLES) {
    const box = el("input", { type: "checkbox", test: `show-${key}` });
    box.addEventListener("change", () => store.set(key, box.checked));
    store.on(key, () => {
      box.checked = store.now[key];
    });
    box.checked = store.now[key];
    section.append(el("label", { class: "tick" }, box, words));
  }
  return section;
}

function shownNames(store: Store, key: "fields" | "flows", title: string): HTMLElement {
  const list = el("div", { test: `view-${key}` });
  const section = el("section", { hidden: true }, el("h3", { text: title }), list);
  const rows = keyed<string>(
    list,
    (name) => name,
    () => nameRow(store, key),
  );
  store.on(["scene", key], () => {
    const names = store.now.scene?.[key].map((each) => (typeof each === "string" ? each : each.name)) ?? [];
    section.hidden = names.length === 0;
    rows(names);
  });
  return section;
}

function nameRow(store: Store, key: "fields" | "flows"): Row<string> {
  let now = "";
  const box = el("input", { type: "checkbox" });
  const words = el("span");
  box.addEventListener("change", () => {
    const others = store.now[key].filter((name) => name !== now);
    store.set(key, box.checked ? [...others, now] : others);
  });
  const full = el("input", { type: "number", class: "number", min: 0, step: "any" });
  full.addEventListener("change", () => {
    const { [now]: _, ...others } = store.now.full;
    const value = Number(full.value);
    store.set("full", value >= 1e-7 && value <= 1e7 ? { ...others, [now]: value } : others);
    full.value = String(fullOf(store.now, now));
  });
  const tick = el("label", { class: "tick" }, box, words);
  return {
    element: key === "fields" ? el("div", { class: "row" }, tick, el("span", { class: "quiet", text: "full at" }), full) : tick,
    update: (name) => {
      now = name;
      full.dataset.test = `full-${name}`;
      full.setAttribute("aria-label", `where the colours of ${name} end`);
      if (document.activeElement !== full) full.value = String(fullOf(store.now, name));
      box.dataset.test = `view-${key}-${name}`;
      box.checked = store.now[key].includes(name);
      setText(words, name);
    },
  };
}

/** Send what this page displays to the server, complete, after each change and after each reconnection. */
function askOnChange(store: Store): void {
  let last = "";
  const ask = () => {
    const { scene, colour, fields, flows, feelers, paths, selected } = store.now;
    const holders = scene?.species.filter((each) => each.attributes.some((attribute) => attribute.name === colour)) ?? [];
    const one = selected.at(-1);
    const message: Extract<Ask, { op: "look" }> = {
      op: "look",
      columns:
        colour === NATURAL || colour === "state" || colour === "speed" || colour.startsWith("state/")
          ? []
          : holders.map((each) => ({ species: each.name, name: colour })),
      fields: fields.filter((name) => scene?.fields.some((field) => field.name === name)),
      flows: flows.filter((name) => scene?.flows.includes(name)),
      solids: true,
      follow: feelers && one ? { species: one.species, agent: one.id } : null,
    };
    if (paths) message.planned = selected.slice(-MOST_PLANNED.chosen).map(({ species, id }) => ({ species, agent: id }));
    const now = JSON.stringify(message);
    if (now === last || !scene) return;
    last = now;
    store.connection.ask(message, true);
  };
  store.on(["scene", "colour", "fields", "flows", "feelers", "paths", "selected"], ask);
}
