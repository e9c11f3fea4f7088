// The feelers of the agent that is looked at, as far as they reach, with a knob where they hit something.

import * as THREE from "three";
import type { Sight } from "../sight";
import { Strokes } from "../strokes";

export function feelers(sight: Sight): void {
  const { stage, store, herds } = sight;
  const strokes = new Strokes(stage, { order: 12, through: true });
  const free = new THREE.Color("#7fd08f");
  const struck = new THREE.Color("#ff6a5a");

  function draw(): void {
    strokes.clear();
    const lines = herds.packet?.arrays.get("feelers");
    const hit = herds.packet?.arrays.get("feelers/hit");
    if (store.now.feelers && store.now.selected.length && lines && hit) {
      for (let k = 0; k < hit.length; k++) {
        const colour = hit[k] ? struck : free;
        strokes.add(lines, 6 * k, lines, 6 * k + 3, 1.6, 1.6, colour, 0.9);
        if (hit[k]) strokes.add(lines, 6 * k + 3, lines, 6 * k + 3, 8, 8, colour, 1); // of no length: drawn as a dot
      }
    }
    if (strokes.count || strokes.object.visible) strokes.done();
  }

  herds.onFrame(draw);
  store.on(["feelers", "selected"], draw);
}
