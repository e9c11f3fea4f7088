// Which agent a click selects: the nearest visible one on the screen; where an agent is on the screen; which place is at a pixel.

import * as THREE from "three";
import type { Place } from "../directing";
import type { Agent } from "../store";
import type { Herd } from "./herds/herd";
import type { Sight } from "./sight";

const REACH = 14; // px
const ASKED = 6; // number of nearest candidates that are tested for visibility

interface Found {
  species: string;
  herd: Herd;
  row: number;
  off: number;
}

const POINT = new THREE.Vector3();
const TURN = new THREE.Vector3();
const MATRIX = new THREE.Matrix4();
const RAY = new THREE.Raycaster();

/** Return the position of an agent's centre on the canvas (CSS px), or null if it is behind the camera or unknown. */
export function onScreen(sight: Sight, agent: Agent): [number, number] | null {
  const herd = sight.herds.byName.get(agent.species);
  const row = herd?.row(agent.id) ?? -1;
  if (!herd || row < 0) return null;
  middle(herd, row, sight.herds.t);
  POINT.applyMatrix4(MATRIX.multiplyMatrices(sight.stage.camera.projectionMatrix, sight.stage.camera.matrixWorldInverse));
  if (POINT.z > 1) return null;
  return [((POINT.x + 1) / 2) * sight.stage.width, ((1 - POINT.y) / 2) * sight.stage.height];
}

/** Return the agent at a position of the canvas (CSS px), if any. */
export function pick(sight: Sight, x: number, y: number): Agent | null {
  const near = candidates(sight, x, y).sort((a, b) => a.off - b.off);
  const open = near.slice(0, ASKED).find((found) => !hidden(sight, found));
  if (!open) return null;
  return { species: open.species, id: open.herd.ids[open.row] as number };
}

/** Return the place at a position of the canvas: an item or agent if they are requested, else the point of the ground. */
export function pickPlace(sight: Sight, x: number, y: number, wanted: { agents: boolean; items: boolean }): Place {
  const item = wanted.items ? pickItem(sight, x, y) : "";
  const agent = wanted.agents && !item ? pick(sight, x, y) : null;
  return { item, agent, point: item || agent ? null : pickGround(sight, x, y) };
}

function pickItem(sight: Sight, x: number, y: number): string {
  const arrays = sight.herds.packet?.arrays;
  const { camera, width, height, focal } = sight.stage;
  let [found, least] = ["", Number.POSITIVE_INFINITY];
  for (const group of sight.store.now.scene?.items ?? []) {
    const positions = arrays?.get(`item/${group.name}/position`);
    for (const [k, name] of group.names.entries()) {
      if (!positions || positions.length < 3 * k + 3) continue;
      POINT.set(positions[3 * k] as number, positions[3 * k + 1] as number, positions[3 * k + 2] as number);
      const far = POINT.distanceTo(camera.position);
      POINT.project(camera);
      if (POINT.z > 1) continue;
      const off = Math.hypot(((POINT.x + 1) / 2) * width - x, ((1 - POINT.y) / 2) * height - y);
      const size = ((arrays?.get(`item/${group.name}/size`)?.[k] as number | undefined) ?? 0) * (focal / far);
      if (off <= Math.max(REACH, 0.6 * size) && off < least) [found, least] = [name, off];
    }
  }
  return found;
}

function pickGround(sight: Sight, x: number, y: number): [number, number, number] | null {
  const { camera, width, height, up } = sight.stage;
  RAY.setFromCamera(new THREE.Vector2((2 * x) / width - 1, 1 - (2 * y) / height), camera);
  RAY.near = 0;
  RAY.far = Number.POSITIVE_INFINITY;
  const hit = RAY.intersectObjects(surfaces(sight), false)[0]?.point;
  if (hit) return hit.toArray();
  // without a mesh, agents walk on the plane through the scene's zero point
  const origin = sight.store.now.verbs?.origin ?? [0, 0, 0];
  const plane = new THREE.Plane(up, up.dot(new THREE.Vector3(...origin)));
  return RAY.ray.intersectPlane(plane, POINT)?.toArray() ?? null;
}

/** Return the meshes that agents can be hidden by. */
function surfaces(sight: Sight): THREE.Object3D[] {
  const things: THREE.Object3D[] = [];
  sight.stage.scene.traverseVisible((each) => {
    if (each instanceof THREE.Mesh && each.userData.hides) things.push(each);
  });
  return things;
}

function candidates(sight: Sight, x: number, y: number): Found[] {
  const { camera, width, height } = sight.stage;
  const e = MATRIX.multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse).elements;
  const found: Found[] = [];
  for (const [species, herd] of sight.herds.byName) {
    for (let row = 0; row < herd.count; row++) {
      middle(herd, row, sight.herds.t);
      const w = e[3] * POINT.x + e[7] * POINT.y + e[11] * POINT.z + e[15];
      if (w <= 0) continue;
      const px = (((e[0] * POINT.x + e[4] * POINT.y + e[8] * POINT.z + e[12]) / w + 1) / 2) * width;
      const py = ((1 - (e[1] * POINT.x + e[5] * POINT.y + e[9] * POINT.z + e[13]) / w) / 2) * height;
      const body = (0.45 * herd.size(row) * sight.stage.focal) / w; // a click on a body selects it, whatever its size
      const off = Math.hypot(px - x, py - y);
      if (off <= Math.max(REACH, body)) found.push({ species, herd, row, off });
    }
  }
  return found;
}

function hidden(sight: Sight, found: Found): boolean {
  middle(found.herd, found.row, sight.herds.t);
  const eye = sight.stage.camera.position;
  const far = POINT.distanceTo(eye);
  RAY.set(eye, POINT.sub(eye).divideScalar(far));
  RAY.near = sight.stage.camera.near;
  RAY.far = far - found.herd.size(found.row) * 0.4;
  const things = surfaces(sight).filter((each) => !((each as THREE.Mesh).material as THREE.Material).transparent);
  return RAY.intersectObjects(things, false).length > 0;
}

/** Write the centre of an agent, a little above its ground, into POINT. */
function middle(herd: Herd, row: number, t: number): void {
  herd.place(row, t, POINT);
  herd.turn("up", row, t, TURN);
  POINT.addScaledVector(TURN, 0.15 * herd.size(row));
}
