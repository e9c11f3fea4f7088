// The 3D view of the ants: stage, scenery and user actions. The parts are listed in two tables, scenery/ and acts/.

import type { Store } from "../store";
import { ACTS } from "./acts/list";
import { Bodies } from "./bodies/bodies";
import { Eye } from "./eye";
import { Herds } from "./herds/herds";
import { nothing } from "./nothing";
import { SCENERY } from "./scenery/list";
import type { Scenery, Sight } from "./sight";
import { Stage } from "./stage";
import "./view.css";

export function view(store: Store, place: HTMLElement): void {
  nothing(store, place);
  let stage: Stage;
  try {
    stage = new Stage(place);
  } catch {
    const words = document.createElement("p");
    words.className = "sight-none";
    words.textContent = "This browser draws nothing in three dimensions: WebGL 2 is switched off or not there. All else works.";
    place.append(words);
    return;
  }
  const herds = new Herds(stage, store);
  const bodies = new Bodies(stage, herds);
  const eye = new Eye(store, stage, herds);
  const sight: Sight = { store, stage, herds, bodies, eye };
  const bySlot = new Map<string, Scenery>();
  for (const make of SCENERY) {
    const scenery = make(sight);
    for (const slot of scenery.slots) bySlot.set(slot, scenery);
  }
  for (const act of ACTS) act(sight);
  store.connection.onPacket((packet) => bySlot.get(packet.slot.split(":", 1)[0] as string)?.take(packet));
}
