// `mesh:NAME`: ground and obstacles, which also may come again, moved. One without faces is taken away.

import * as THREE from "three";
import { creased } from "../creases";
import { earth } from "../earth";
import type { Scenery, Sight } from "../sight";

export function meshes(sight: Sight): Scenery {
  const { stage, herds } = sight;
  const grains = { value: 1 };
  const shown = new Map<string, THREE.Mesh>();
  const stuff = new Map(["ground", "obstacle"].map((role) => [role, earth(stage, role as "ground" | "obstacle", grains)]));

  function measure(): void {
    for (const herd of herds.byName.values()) if (herd.count) grains.value = Math.max(herd.size(0) * 0.35, stage.extent / 3000);
  }
  herds.onFrame(measure);

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
        const role = packet.header.role === "obstacle" ? "obstacle" : "ground";
        const mesh = new THREE.Mesh(creased(position, face), stuff.get(role));
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
