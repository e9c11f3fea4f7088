// `curve:NAME`: curves of the scene.

import * as THREE from "three";
import type { Scenery, Sight } from "../sight";
import { Strokes } from "../strokes";

export function curves(sight: Sight): Scenery {
  const { stage, store } = sight;
  const shown = new Map<string, { strokes: Strokes; point: Float32Array; closed: boolean }>();

  function draw(): void {
    for (const { strokes, point, closed } of shown.values()) {
      strokes.clear();
      const colour = new THREE.Color(stage.palette.mark);
      const last = closed ? point.length : point.length - 3;
      for (let k = 0; k < last; k += 3) strokes.add(point, k, point, (k + 3) % point.length, 2, 2, colour, 0.8);
      strokes.done();
      strokes.object.visible = store.now.curvesShown;
    }
    stage.wake();
  }

  stage.palette.onChange(draw);
  store.on("curvesShown", draw);
  store.on("scene", () => {
    for (const [name, each] of shown) {
      if (store.now.scene?.curves.includes(name)) continue;
      each.strokes.dispose();
      shown.delete(name);
    }
  });

  return {
    slots: ["curve"],
    take(packet) {
      const name = packet.slot.slice(6);
      const strokes = shown.get(name)?.strokes ?? new Strokes(stage, { order: 4, through: true });
      const point = (packet.arrays.get("point") as Float32Array | undefined) ?? new Float32Array(0);
      shown.set(name, { strokes, point, closed: packet.header.closed === true });
      draw();
    },
  };
}
