// A ring around each selected agent: bright for the explained agent, paler for the others.

import * as THREE from "three";
import { changed, rowAttributes } from "../bodies/shapes";
import { ringMaterial, square, standing } from "../bodies/bodyshaders";
import { Rows } from "../herds/herd";
import type { Sight } from "../sight";

export function marks(sight: Sight): void {
  const { stage, store, herds } = sight;
  const rows = new Rows();
  rows.reserve(8);
  const uniforms = standing(stage);
  const meshes = [true, false].map((through) => {
    const mesh = new THREE.Mesh(square(), ringMaterial(uniforms, through));
    mesh.frustumCulled = false;
    mesh.renderOrder = through ? 20 : 21;
    stage.scene.add(mesh);
    return mesh;
  });
  let attributes = new Map<string, THREE.InstancedBufferAttribute>();
  let version = -1;

  function bind(): void {
    version = rows.version;
    attributes = rowAttributes(rows);
    for (const mesh of meshes) {
      mesh.geometry.dispose();
      mesh.geometry = square();
      for (const [name, attribute] of attributes) mesh.geometry.setAttribute(name, attribute);
    }
  }

  function refresh(): void {
    const { selected } = store.now;
    rows.reserve(selected.length);
    if (version !== rows.version) bind();
    const { mark, ink } = stage.palette;
    let count = 0;
    for (let k = 0; k < selected.length; k++) {
      const agent = selected[k] as { species: string; id: number };
      const herd = herds.byName.get(agent.species);
      const row = herd?.row(agent.id) ?? -1;
      if (!herd || row < 0 || (store.now.camera === "ride" && k === selected.length - 1)) continue; // the camera rides on this agent
      rows.copy(count, herd.rows, row);
      tone(rows.tone, count, k === selected.length - 1 ? mark : ink);
      count++;
    }
    for (const attribute of attributes.values()) changed(attribute, count);
    for (const mesh of meshes) {
      mesh.geometry.instanceCount = count;
      mesh.visible = count > 0;
    }
    stage.wake();
  }

  herds.onFrame(refresh);
  store.on(["selected", "camera"], refresh);
  stage.palette.onChange(refresh);
  stage.add(() => {
    uniforms.t.value = herds.t;
    uniforms.focal.value = stage.focal;
    return false;
  });
}

function tone(into: Uint8Array, row: number, colour: THREE.Color): void {
  const shown = colour.getHex(THREE.SRGBColorSpace);
  into[4 * row] = shown >> 16;
  into[4 * row + 1] = (shown >> 8) & 255;
  into[4 * row + 2] = shown & 255;
  into[4 * row + 3] = 255;
}
