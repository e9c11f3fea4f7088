// Meshes for the shaders, and the rows of agents as instanced attributes.

import * as THREE from "three";
import type { Rows } from "../herds/herd";

/** A rigid mesh. */
export interface Shape {
  position: Float32Array;
  normal: Float32Array;
  face: Uint32Array;
}

/** Return the arrays of rows as instanced attributes, under the names in the shaders. */
export function rowAttributes(rows: Rows): Map<string, THREE.InstancedBufferAttribute> {
  const made = new Map<string, THREE.InstancedBufferAttribute>();
  for (const name of ["placeA", "placeB"] as const) made.set(name, new THREE.InstancedBufferAttribute(rows[name], 3));
  for (const name of ["headA", "headB", "upA", "upB"] as const) {
    made.set(name, new THREE.InstancedBufferAttribute(rows[name], 4, true));
  }
  made.set("size", new THREE.InstancedBufferAttribute(rows.size, 1));
  made.set("wears", new THREE.InstancedBufferAttribute(rows.wears, 1));
  made.set("tone", new THREE.InstancedBufferAttribute(rows.tone, 4, true));
  for (const attribute of made.values()) attribute.setUsage(THREE.DynamicDrawUsage);
  return made;
}

export function changed(attribute: THREE.BufferAttribute, count: number): void {
  attribute.clearUpdateRanges();
  attribute.addUpdateRange(0, count * attribute.itemSize);
  attribute.needsUpdate = true;
}

export function bodyGeometry(shape: Shape): THREE.InstancedBufferGeometry {
  const made = new THREE.InstancedBufferGeometry();
  made.setAttribute("position", new THREE.BufferAttribute(shape.position, 3));
  made.setAttribute("normal", new THREE.BufferAttribute(shape.normal, 3));
  made.setIndex(new THREE.BufferAttribute(shape.face, 1));
  return made;
}
