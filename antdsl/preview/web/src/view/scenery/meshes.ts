// `mesh:NAME`: ground and obstacles. A new packet replaces a moved mesh; a packet without faces removes it.

import * as THREE from "three";
import { creased } from "../creases";
import { type Stuff, earth } from "../earth";
import type { Scenery, Sight } from "../sight";

const STUFFS: Stuff[] = ["ground", "shape", "obstacle"];

export function meshes(sight: Sight): Scenery {
  const { stage, herds } = sight;
  const grains = { value: 1 };
  const shown = new Map<string, THREE.Mesh>();
  const stuff = new Map<Stuff, THREE.Material>(STUFFS.map((each) => [each, earth(sight, each, grains)]));

  let first: string | null = null;

  function measure(): void {
    for (const herd of herds.byName.values()) if (herd.count) grains.value = Math.max(herd.size(0) * 0.35, stage.extent / 3000);
  }
  herds.onFrame(measure);

  /** The first ground mesh gets the colour of ground; other walkable meshes get another colour. */
  function of(name: string, obstacle: boolean): Stuff {
    if (obstacle) return "obstacle";
    first ??= name;
    return name === first ? "ground" : "shape";
  }

  return {
    slots: ["mesh"],
    take(packet) {
      const name = packet.slot;
      const position = packet.arrays.get("position") as Float32Array;
      const face = Uint32Array.from(packet.arrays.get("face") ?? []);
      const before = shown.get(name);
      if (before) drop(stage.scene, before);
      shown.delete(name);
      if (face.length > 0) {
        const mesh = new THREE.Mesh(creased(position, face), stuff.get(of(name, packet.header.role === "obstacle")));
        mesh.castShadow = mesh.receiveShadow = true;
        mesh.userData = { hides: true };
        stage.scene.add(mesh);
        shown.set(name, mesh);
      }
      stage.relight();
    },
  };
}

function drop(scene: THREE.Scene, mesh: THREE.Mesh): void {
  scene.remove(mesh);
  mesh.geometry.dispose();
}
