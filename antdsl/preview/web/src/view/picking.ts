// Which agent a click selects: the nearest visible one on the screen; and where an agent is on the screen.

import * as THREE from "three";
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
  const things: THREE.Object3D[] = [];
  sight.stage.scene.traverseVisible((each) => {
    if (each instanceof THREE.Mesh && each.userData.hides && !each.material.transparent) things.push(each);
  });
  return RAY.intersectObjects(things, false).length > 0;
}

/** Write the centre of an agent, a little above its ground, into POINT. */
function middle(herd: Herd, row: number, t: number): void {
  herd.place(row, t, POINT);
  herd.turn("up", row, t, TURN);
  POINT.addScaledVector(TURN, 0.15 * herd.size(row));
}
