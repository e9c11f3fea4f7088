// Bodies as the shaders read them: the mesh with its poses in a texture, and the rows of agents as attributes of instances.

import * as THREE from "three";
import type { Uniforms } from "./bodyshaders";
import type { Rows } from "./herd";

export interface Shape {
  poses: Float32Array; // k × n × 3
  count: number;
  normal: Float32Array;
  face: Uint32Array;
  tint: Float32Array;
}

/** The arrays of rows as attributes of instances, under the names that the shaders have for them. */
export function rowAttributes(rows: Rows): Map<string, THREE.InstancedBufferAttribute> {
  const made = new Map<string, THREE.InstancedBufferAttribute>();
  for (const name of ["placeA", "placeB", "gait"] as const) made.set(name, new THREE.InstancedBufferAttribute(rows[name], 3));
  for (const name of ["headA", "headB", "upA", "upB"] as const) {
    made.set(name, new THREE.InstancedBufferAttribute(rows[name], 4, true));
  }
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
  made.setAttribute("position", new THREE.BufferAttribute(shape.poses.subarray(0, shape.normal.length), 3));
  made.setAttribute("normal", new THREE.BufferAttribute(shape.normal, 3));
  made.setAttribute("tint", new THREE.BufferAttribute(shape.tint, 1));
  made.setIndex(new THREE.BufferAttribute(shape.face, 1));
  return made;
}

/** Have the poses of a shape drawn. */
export function pose(uniforms: Uniforms, shape: Shape): void {
  (uniforms.poses.value as THREE.Texture | null)?.dispose();
  uniforms.poses.value = texture(shape);
  uniforms.moments.value = shape.count;
}

function texture(shape: Shape): THREE.DataTexture {
  const vertices = shape.normal.length / 3;
  const texels = new Float32Array(vertices * shape.count * 4);
  for (let k = 0; k < vertices * shape.count; k++) {
    for (let axis = 0; axis < 3; axis++) texels[4 * k + axis] = shape.poses[3 * k + axis] as number;
  }
  const made = new THREE.DataTexture(texels, vertices, shape.count, THREE.RGBAFormat, THREE.FloatType);
  made.needsUpdate = true;
  return made;
}
