// Normals for meshes with smooth ground and sharp edges.

import * as THREE from "three";

const SHARP = Math.cos(Math.PI / 5); // a face at a larger angle to the mean of the faces at a corner gets its own normal

/** Return vertices and faces with normals. Corners at sharp edges are repeated for each face. */
export function creased(position: Float32Array, face: Uint32Array): THREE.BufferGeometry {
  const normals = faceNormals(position, face);
  const smooth = vertexNormals(position.length, face, normals);
  const own: number[] = []; // corners with their own normal
  for (let corner = 0; corner < face.length; corner++) {
    const v = 3 * (face[corner] as number);
    const f = 3 * Math.floor(corner / 3);
    const long = Math.hypot(normals[f] as number, normals[f + 1] as number, normals[f + 2] as number);
    let along = 0;
    for (let axis = 0; axis < 3; axis++) along += (smooth[v + axis] as number) * (normals[f + axis] as number);
    if (along < SHARP * long) own.push(corner);
  }
  const count = position.length / 3;
  const places = new Float32Array(3 * (count + own.length));
  const turns = new Float32Array(places.length);
  const faces = Uint32Array.from(face);
  places.set(position);
  turns.set(smooth);
  own.forEach((corner, number) => {
    const v = 3 * (face[corner] as number);
    const f = 3 * Math.floor(corner / 3);
    const long = Math.hypot(normals[f] as number, normals[f + 1] as number, normals[f + 2] as number);
    for (let axis = 0; axis < 3; axis++) {
      places[3 * (count + number) + axis] = position[v + axis] as number;
      turns[3 * (count + number) + axis] = (normals[f + axis] as number) / long;
    }
    faces[corner] = count + number;
  });
  const made = new THREE.BufferGeometry();
  made.setAttribute("position", new THREE.BufferAttribute(places, 3));
  made.setAttribute("normal", new THREE.BufferAttribute(turns, 3));
  made.setIndex(new THREE.BufferAttribute(faces, 1));
  return made;
}

/** Return the normals of all faces, with a length of twice the area. */
function faceNormals(position: Float32Array, face: Uint32Array): Float32Array {
  const found = new Float32Array(face.length);
  const at = (corner: number, axis: number) => position[3 * (face[corner] as number) + axis] as number;
  for (let f = 0; f < face.length; f += 3) {
    const [ax, ay, az] = [at(f + 1, 0) - at(f, 0), at(f + 1, 1) - at(f, 1), at(f + 1, 2) - at(f, 2)];
    const [bx, by, bz] = [at(f + 2, 0) - at(f, 0), at(f + 2, 1) - at(f, 1), at(f + 2, 2) - at(f, 2)];
    found[f] = ay * bz - az * by;
    found[f + 1] = az * bx - ax * bz;
    found[f + 2] = ax * by - ay * bx;
  }
  return found;
}

/** Return the mean normal of the faces around each vertex, of length 1. */
function vertexNormals(length: number, face: Uint32Array, normals: Float32Array): Float32Array {
  const found = new Float32Array(length);
  for (let corner = 0; corner < face.length; corner++) {
    const f = 3 * Math.floor(corner / 3);
    for (let axis = 0; axis < 3; axis++) {
      const k = 3 * (face[corner] as number) + axis;
      found[k] = (found[k] as number) + (normals[f + axis] as number);
    }
  }
  for (let v = 0; v < length; v += 3) {
    const long = Math.hypot(found[v] as number, found[v + 1] as number, found[v + 2] as number) || 1;
    for (let axis = 0; axis < 3; axis++) found[v + axis] = (found[v + axis] as number) / long;
  }
  return found;
}
