// The camera: free around a point, following an agent, or riding on its back.

import * as THREE from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import type { NumberArray, Scene } from "../protocol";
import type { Agent, Store } from "../store";
import type { Herds } from "./herds/herds";
import type { Stage } from "./stage";

const EASE = 160; // ms in which the camera of a rider approaches a new direction
const FROM = new THREE.Vector3(0.2, 0.72, 0.8); // direction of the first view, with y up
const UP = new THREE.Vector3(0, 1, 0);
const AROUND = 0.22; // free margin around the target, as a share of the view
const WIDE = 16 / 9; // aspect ratio of the scene's camera
const ENOUGH = 0.5; // share of agents that the scene's camera must see to be used for the first view

export class Eye {
  private controls: OrbitControls;
  private seen = ""; // the scene of the last overview
  private at = 0;
  private placed = false;
  private fresh = false; // whether this scene has no view yet
  private first: (() => void) | null = null; // repeats the first view, until the user moves the camera
  private readonly look = new THREE.Vector3();
  private readonly clipped = new THREE.Vector3(Number.POSITIVE_INFINITY, 0, 0); // camera position at the last change of the clipping planes
  private readonly seat = new THREE.Vector3();
  private readonly here = new THREE.Vector3();
  private readonly head = new THREE.Vector3();
  private readonly above = new THREE.Vector3();

  constructor(
    private readonly store: Store,
    private readonly stage: Stage,
    private readonly herds: Herds,
  ) {
    this.controls = this.control();
    store.on("scene", () => this.scene(store.now.scene as Scene));
    store.on(["camera", "selected"], () => this.mode());
    herds.onFrame(() => this.begin());
    stage.onResize(() => this.first?.()); // the page may still change its size when the first frame arrives
    stage.add((now) => this.move(now));
  }

  /** Return the agent that the camera follows: the last selected one, or the first of all. */
  get follows(): Agent | null {
    const last = this.store.now.selected.at(-1);
    if (last && (this.herds.byName.get(last.species)?.row(last.id) ?? -1) >= 0) return last;
    for (const [species, herd] of this.herds.byName) if (herd.count) return { species, id: herd.ids[0] as number };
    return null;
  }

  /** Return target and position in mm. */
  get place(): { at: THREE.Vector3; target: THREE.Vector3 } {
    return { at: this.stage.camera.position, target: this.controls.target };
  }

  /** Show everything. */
  all(): void {
    this.first = null;
    this.fit(this.stage.low, this.stage.high);
  }

  /** Show all agents, from the current direction or from above. */
  crowd(fromAbove: boolean): void {
    this.first = null;
    const { camera, up } = this.stage;
    const box = new THREE.Box3();
    let long = 0;
    for (const herd of this.herds.byName.values()) {
      for (let row = 0; row < herd.count; row++) {
        herd.place(row, this.herds.t, this.here);
        box.expandByPoint(this.here);
        long = Math.max(long, herd.size(row));
      }
    }
    if (box.isEmpty()) return;
    const way = camera.position.clone().sub(this.controls.target).normalize();
    if (fromAbove) {
      const aside = new THREE.Vector3(0, 0, 1).applyQuaternion(new THREE.Quaternion().setFromUnitVectors(UP, up));
      way.copy(up).addScaledVector(aside, 1e-3); // defines the up direction of the picture
    }
    box.expandByScalar(long);
    this.fit(box.min, box.max, way.normalize());
  }

  /** Use the scene's own camera, from farther away if the view has another shape. Return whether the scene has a camera. */
  own(): boolean {
    this.first = null;
    return this.likeScene();
  }

  private likeScene(): boolean {
    const camera = this.store.now.scene?.camera;
    if (!camera) return false;
    const target = new THREE.Vector3(...camera.look_at);
    const off = new THREE.Vector3(...camera.at).sub(target);
    const half = (18 / camera.focal) * off.length();
    const tan = Math.tan((this.stage.camera.fov * Math.PI) / 360);
    this.controls.target.copy(target);
    this.stage.camera.position
      .copy(target)
      .addScaledVector(off.normalize(), Math.max(half / WIDE, half / this.stage.camera.aspect) / tan);
    if (this.store.now.camera !== "orbit") this.store.set("camera", "orbit");
    this.controls.update();
    this.stage.wake();
    return true;
  }

  /** Return the share of positions that lie within the view. */
  private share(places: readonly NumberArray[]): number {
    const { camera } = this.stage;
    this.clip(); // the far plane still belongs to the previous camera
    camera.updateMatrixWorld();
    let seen = 0;
    let all = 0;
    for (const place of places) {
      for (let k = 0; k < place.length; k += 3, all++) {
        this.here.fromArray(place, k).project(camera);
        if (Math.abs(this.here.x) < 1 && Math.abs(this.here.y) < 1 && this.here.z < 1) seen++;
      }
    }
    return all ? seen / all : 0;
  }

  /** Show the first view: the scene's camera, or else the agents and the items around them, which may be a small part of
   * the ground. */
  private begin(): void {
    if (!this.fresh || this.herds.count === 0) return;
    this.fresh = false;
    const places = [...(this.herds.packet?.arrays ?? [])]
      .filter(([name]) => name.endsWith("/position"))
      .map(([, place]) => place);
    this.first = () => this.beginAt(places);
    this.first();
  }

  private beginAt(places: readonly NumberArray[]): void {
    if (this.likeScene() && this.share(places) >= ENOUGH) return;
    const box = new THREE.Box3();
    for (const place of places) for (let k = 0; k < place.length; k += 3) box.expandByPoint(this.here.fromArray(place, k));
    box.expandByScalar(box.getSize(this.here).length() * AROUND);
    box.intersect(new THREE.Box3(this.stage.low, this.stage.high));
    if (box.isEmpty()) this.fit(this.stage.low, this.stage.high);
    else this.fit(box.min, box.max);
  }

  /** Show everything between two corners, from the direction `from`. */
  private fit(low: THREE.Vector3, high: THREE.Vector3, from = this.usual()): void {
    const { stage } = this;
    const { camera } = stage;
    const centre = low.clone().add(high).multiplyScalar(0.5);
    camera.position.copy(centre).add(from);
    camera.lookAt(centre);
    const back = camera.quaternion.clone().invert();
    const tan = Math.tan((camera.fov * Math.PI) / 360);
    const corner = new THREE.Vector3();
    let far = stage.extent * 0.01;
    for (let k = 0; k < 8; k++) {
      corner
        .set(k & 1 ? high.x : low.x, k & 2 ? high.y : low.y, k & 4 ? high.z : low.z)
        .sub(centre)
        .applyQuaternion(back);
      far = Math.max(far, Math.abs(corner.y) / tan + corner.z, Math.abs(corner.x) / (tan * camera.aspect) + corner.z);
    }
    this.controls.target.copy(centre);
    camera.position.copy(centre).addScaledVector(from, far * 1.02);
    if (this.store.now.camera !== "orbit") this.store.set("camera", "orbit");
    this.controls.update();
    stage.wake();
  }

  /** Return the direction of the first view, for the up direction of the scene. */
  private usual(): THREE.Vector3 {
    return FROM.clone().normalize().applyQuaternion(new THREE.Quaternion().setFromUnitVectors(UP, this.stage.up));
  }

  /** Move close to the followed agent. */
  near(): void {
    this.first = null;
    const agent = this.follows;
    if (!agent || !this.find(agent)) return;
    const herd = this.herds.byName.get(agent.species);
    const size = herd?.size(herd.row(agent.id)) ?? 1;
    const way = this.stage.camera.position.clone().sub(this.controls.target).normalize();
    this.controls.target.copy(this.here);
    this.stage.camera.position.copy(this.here).addScaledVector(way, size * 22);
    this.controls.update();
    this.stage.wake();
  }

  /** Turn around the target, by radians across and up. `closer`: factor of the distance. */
  turn(across: number, up: number, closer = 1): void {
    this.first = null;
    const { camera } = this.stage;
    const off = camera.position.clone().sub(this.controls.target);
    off.applyAxisAngle(this.stage.up, across);
    const side = new THREE.Vector3().crossVectors(this.stage.up, off).normalize();
    const angle = off.angleTo(this.stage.up);
    off.applyAxisAngle(side, Math.min(Math.max(angle + up, 0.05), Math.PI - 0.05) - angle);
    const far = Math.min(Math.max(off.length() * closer, this.controls.minDistance), this.controls.maxDistance);
    camera.position.copy(this.controls.target).addScaledVector(off.normalize(), far);
    this.controls.update();
    this.stage.wake();
  }

  /** Stop or resume the control of the camera by the user. */
  rest(still: boolean): void {
    this.controls.enabled = !still && this.store.now.camera !== "ride";
  }

  private control(): OrbitControls {
    const made = new OrbitControls(this.stage.camera, this.stage.canvas);
    made.enableDamping = true;
    made.dampingFactor = 0.12;
    made.zoomToCursor = true;
    made.addEventListener("change", () => this.stage.wake());
    made.addEventListener("start", () => {
      this.first = null;
    });
    return made;
  }

  private scene(scene: Scene): void {
    const { stage } = this;
    const low = new THREE.Vector3(...scene.low);
    const high = new THREE.Vector3(...scene.high);
    const same = low.equals(stage.low) && high.equals(stage.high) && this.seen === scene.name;
    stage.frame(low, high, new THREE.Vector3(...scene.up));
    this.controls.dispose();
    const target = this.controls.target.clone();
    this.controls = this.control(); // the controls read the up direction when they are created
    this.controls.target.copy(target);
    this.controls.minDistance = stage.extent * 5e-4;
    this.controls.maxDistance = stage.extent * 4;
    if (!same) {
      this.seen = scene.name;
      this.fresh = true;
      this.first = null;
      this.fit(low, high);
    }
    this.mode();
  }

  private mode(): void {
    if (this.store.now.camera !== "orbit") this.first = null;
    this.controls.enabled = this.store.now.camera !== "ride";
    this.placed = false;
    this.stage.wake();
  }

  private find(agent: Agent): boolean {
    const herd = this.herds.byName.get(agent.species);
    const row = herd?.row(agent.id) ?? -1;
    if (!herd || row < 0) return false;
    herd.place(row, this.herds.t, this.here);
    herd.turn("head", row, this.herds.t, this.head);
    herd.turn("up", row, this.herds.t, this.above);
    return true;
  }

  private move(now: number): boolean {
    const part = 1 - Math.exp(-Math.min(now - this.at, 200) / EASE);
    this.at = now;
    const mode = this.store.now.camera;
    const agent = mode === "orbit" ? null : this.follows;
    let moving = false;
    if (agent && this.find(agent)) {
      if (mode === "follow") this.follow();
      else moving = this.ride(agent, part);
    }
    if (this.controls.enabled) moving = this.controls.update() || moving;
    this.clip();
    return moving;
  }

  private follow(): void {
    if (!this.placed) {
      this.placed = true;
      const far = this.stage.camera.position.distanceTo(this.controls.target);
      if (far > this.stage.extent * 0.5) this.near();
    }
    this.stage.camera.position.add(this.here).sub(this.controls.target);
    this.controls.target.copy(this.here);
  }

  private ride(agent: Agent, part: number): boolean {
    const herd = this.herds.byName.get(agent.species);
    const size = herd?.size(herd.row(agent.id)) ?? 1;
    this.seat
      .copy(this.here)
      .addScaledVector(this.above, size * 1.15)
      .addScaledVector(this.head, size * -1.9);
    this.here.addScaledVector(this.head, size * 2.2).addScaledVector(this.above, size * 0.1);
    const { camera } = this.stage;
    const eased = this.placed ? part : 1;
    this.placed = true;
    const left = this.seat.distanceTo(camera.position);
    camera.position.lerp(this.seat, eased);
    this.look.lerp(this.here, eased);
    camera.up.lerp(this.above, eased).normalize();
    camera.lookAt(this.look);
    camera.up.copy(this.stage.up);
    this.controls.target.copy(this.look);
    return left > size * 0.01;
  }

  /** Set the near and far clipping planes by the camera's position. */
  private clip(): void {
    const { stage } = this;
    const { camera } = stage;
    const far = camera.position.distanceTo(this.controls.target);
    const near = Math.max(far * 0.02, stage.extent * 1e-5);
    if (Math.abs(camera.near / near - 1) < 0.1 && this.clipped.distanceTo(camera.position) < stage.extent) return;
    this.clipped.copy(camera.position);
    camera.near = near;
    camera.far = camera.position.length() + stage.extent * 3;
    camera.updateProjectionMatrix();
  }
}
