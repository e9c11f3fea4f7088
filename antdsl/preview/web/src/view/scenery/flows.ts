// `flow:NAME`: flow directions, as arrows on the ground.

import * as THREE from "three";
import { HUES } from "../../hues";
import type { Scenery, Sight } from "../sight";
import { Strokes } from "../strokes";

export function flows(sight: Sight): Scenery {
  const { stage, store } = sight;
  const shown = new Map<string, Strokes>();
  const from = new Float32Array(3);
  const to = new Float32Array(3);

  function refresh(): void {
    for (const [name, strokes] of shown) strokes.object.visible = store.now.flows.includes(name) && strokes.count > 0;
    stage.wake();
  }

  store.on("flows", refresh);
  store.on("scene", () => {
    for (const [name, strokes] of shown) {
      if (store.now.scene?.flows.includes(name)) continue;
      strokes.dispose();
      shown.delete(name);
    }
  });

  return {
    slots: ["flow"],
    take(packet) {
      const name = packet.slot.slice(5);
      const strokes = shown.get(name) ?? new Strokes(stage, { order: 4 });
      shown.set(name, strokes);
      const place = packet.arrays.get("from");
      const way = packet.arrays.get("way");
      strokes.clear();
      const order = Math.max(store.now.scene?.flows.indexOf(name) ?? 0, 0);
      const colour = new THREE.Color(HUES[order % HUES.length]);
      for (let k = 0; place && way && k < place.length; k += 3) {
        for (let axis = 0; axis < 3; axis++) {
          from[axis] = place[k + axis] as number;
          to[axis] = (place[k + axis] as number) + (way[k + axis] as number);
        }
        strokes.arrow(from, to, 1.4, colour, 0.85, 0.38);
      }
      strokes.done();
      refresh();
    },
  };
}
