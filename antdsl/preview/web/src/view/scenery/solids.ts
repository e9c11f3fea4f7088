// `solid:NAME:N`: pieces of solids as they are dug. An empty packet removes a piece.

import * as THREE from "three";
import { earth } from "../earth";
import type { Scenery, Sight } from "../sight";

export function solids(sight: Sight): Scenery {
  const { stage, herds } = sight;
  const grains = { value: 1 };
  const pieces = new Map<string, THREE.Mesh>();
  const stuff = earth(sight, "earth", grains);
  herds.onFrame(() => {
    for (const herd of herds.byName.values()) if (herd.count) grains.value = Math.max(herd.size(0) * 0.35, stage.extent / 3000);
  });

  function away(slot: string): void {
    const old = pieces.get(slot);
    if (!old) return;
    stage.scene.remove(old);
    old.geometry.dispose();
    pieces.delete(slot);
  }

  sight.store.on("scene", () => {
    const names = new Set(sight.store.now.scene?.solids);
    for (const slot of [...pieces.keys()]) if (!names.has(slot.slice(6, slot.lastIndexOf(":")))) away(slot);
  });

  return {
    slots: ["solid"],
    take(packet) {
      away(packet.slot);
      const face = packet.arrays.get("face");
      if (face?.length) {
        const geometry = new THREE.BufferGeometry();
        geometry.setAttribute("position", new THREE.BufferAttribute(packet.arrays.get("position") as Float32Array, 3));
        geometry.setIndex(new THREE.BufferAttribute(Uint32Array.from(face), 1));
        const normal = packet.arrays.get("normal");
        if (normal?.length) geometry.setAttribute("normal", new THREE.BufferAttribute(normal as Float32Array, 3));
        else geometry.computeVertexNormals();
        const mesh = new THREE.Mesh(geometry, stuff);
        mesh.castShadow = mesh.receiveShadow = true;
        mesh.userData.hides = true;
        stage.scene.add(mesh);
        pieces.set(packet.slot, mesh);
      }
      stage.relight();
    },
  };
}
