// The feelers of the followed agent, at full length, with a knob where they hit something.

import * as THREE from "three";
import type { NumberArray } from "../../protocol";
import type { Sight } from "../sight";
import { Strokes } from "../strokes";

const UP = new THREE.Vector3();

export function feelers(sight: Sight): void {
  const { stage, store, herds, eye } = sight;
  const strokes = new Strokes(stage, { order: 12, through: true });
  const free = new THREE.Color("#7fd08f");
  const struck = new THREE.Color("#ff6a5a");

  /** Start at the height of the head. At ground level, the ground would hide the feelers. */
  function raise(lines: NumberArray): Float32Array {
    const agent = eye.follows;
    const herd = agent ? herds.byName.get(agent.species) : undefined;
    const row = agent ? (herd?.row(agent.id) ?? -1) : -1;
    if (!herd || row < 0) return Float32Array.from(lines);
    herd.turn("up", row, 1, UP);
    return Float32Array.from(lines, (part, k) => part + UP.getComponent(k % 3) * 0.16 * herd.size(row));
  }

  /** Return which feelers belong to the agent that this page follows; other pages may follow other agents. */
  function own(felt: [string, number, number][]): [number, number] {
    const agent = eye.follows;
    let first = 0;
    for (const [species, id, count] of felt) {
      if (species === agent?.species && id === agent.id) return [first, first + count];
      first += count;
    }
    return [0, 0];
  }

  function draw(): void {
    strokes.clear();
    const lines = herds.packet?.arrays.get("feelers");
    const hit = herds.packet?.arrays.get("feelers/hit");
    if (store.now.feelers && store.now.selected.length && lines && hit) {
      const raised = raise(lines);
      const [first, last] = own(herds.packet?.header.felt ?? []);
      for (let k = first; k < last; k++) {
        const colour = hit[k] ? struck : free;
        strokes.add(raised, 6 * k, raised, 6 * k + 3, 1.8, 1.8, colour, 0.95);
        if (hit[k]) strokes.add(raised, 6 * k + 3, raised, 6 * k + 3, 8, 8, colour, 1); // of length 0: a dot
      }
    }
    if (strokes.count || strokes.object.visible) strokes.done();
  }

  herds.onFrame(draw);
  store.on(["feelers", "selected"], draw);
}
