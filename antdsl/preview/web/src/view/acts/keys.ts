// Keyboard control of the view, and the selection as text for screen readers. One entry for each key.

import { type Agent, NATURAL } from "../../store";
import { machineOf } from "../herds/colours";
import type { Sight } from "../sight";

const TURN = Math.PI / 24;
const HELP =
  "Ants in space. Arrows turn, plus and minus come closer, n and p go from ant to ant, f shows all, h all ants, v all ants from above, g goes near the selected ant, c looks as the scene's camera does, 1, 2 and 3 choose the camera: free, follow, ride, s shows the colours of states, t shows trails, a planned paths, x sees through stones.";

type Act = (sight: Sight) => void;

const KEYS = new Map<string, Act>([
  ["ArrowLeft", ({ eye }) => eye.turn(-TURN, 0)],
  ["ArrowRight", ({ eye }) => eye.turn(TURN, 0)],
  ["ArrowUp", ({ eye }) => eye.turn(0, -TURN)],
  ["ArrowDown", ({ eye }) => eye.turn(0, TURN)],
  ["+", ({ eye }) => eye.turn(0, 0, 0.85)],
  ["=", ({ eye }) => eye.turn(0, 0, 0.85)],
  ["-", ({ eye }) => eye.turn(0, 0, 1 / 0.85)],
  ["f", ({ eye }) => eye.all()],
  ["h", ({ eye }) => eye.crowd(false)],
  ["v", ({ eye }) => eye.crowd(true)],
  ["g", ({ eye }) => eye.near()],
  ["c", ({ eye }) => void eye.own()],
  ["1", ({ store }) => store.set("camera", "orbit")],
  ["2", (sight) => keep(sight, "follow")],
  ["3", (sight) => keep(sight, "ride")],
  ["x", ({ store }) => store.set("glass", !store.now.glass)],
  ["s", ({ store }) => store.set("colour", store.now.colour === NATURAL ? "state" : NATURAL)],
  ["t", ({ store }) => store.set("trails", !store.now.trails)],
  ["a", ({ store }) => store.set("paths", !store.now.paths)],
  ["n", (sight) => next(sight, 1)],
  ["p", (sight) => next(sight, -1)],
  ["Escape", ({ store }) => (store.now.picking ? store.set("picking", null) : store.set("selected", []))],
]);

export function keys(sight: Sight): void {
  const { stage, store } = sight;
  stage.canvas.setAttribute("role", "application");
  stage.canvas.setAttribute("aria-label", HELP);
  stage.canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const act = KEYS.get(event.key.length === 1 ? event.key.toLowerCase() : event.key);
    if (!act) return;
    event.preventDefault();
    event.stopPropagation(); // here, arrow keys turn the camera and do not step through frames
    act(sight);
  });
  const words = document.createElement("p");
  words.className = "sight-said";
  words.setAttribute("role", "status");
  stage.place.append(words);
  store.on("selected", () => {
    words.textContent = describeSelection(sight);
  });
}

/** Follow or ride the selected agent, or the first agent if none is selected. */
function keep({ store, eye }: Sight, camera: "follow" | "ride"): void {
  const agent = eye.follows;
  if (!agent) return;
  if (store.now.selected.length === 0) store.set("selected", [agent]);
  store.set("camera", camera);
}

function next({ store, herds }: Sight, way: 1 | -1): void {
  const all = [...herds.byName].filter((each) => each[1].count > 0);
  if (!all.length) return;
  const last: Agent | undefined = store.now.selected.at(-1);
  let place = Math.max(
    all.findIndex(([name]) => name === last?.species),
    0,
  );
  let row = last ? (all[place]?.[1].row(last.id) ?? -1) + way : 0;
  if (row < 0) {
    place = (place + all.length - 1) % all.length;
    row = (all[place]?.[1].count ?? 1) - 1;
  } else if (row >= (all[place]?.[1].count ?? 0)) {
    place = (place + 1) % all.length;
    row = 0;
  }
  const [species, herd] = all[place] as (typeof all)[number];
  store.set("selected", [{ species, id: herd.ids[row] as number }]);
}

function describeSelection({ store, herds }: Sight): string {
  const { selected } = store.now;
  const last = selected.at(-1);
  if (!last) return "no agent is selected";
  if (selected.length > 1) return `${selected.length.toLocaleString("en")} selected`;
  const herd = herds.byName.get(last.species);
  const row = herd?.row(last.id) ?? -1;
  if (!herd || row < 0) return `${last.species} ${last.id} is not there in this frame`;
  const machine = machineOf(herd.species, "state");
  const state = machine?.states[herd.column(`state/${machine.name}`)?.[row] as number];
  return `${last.species} ${last.id}${state ? `, ${state}` : ""}`;
}
