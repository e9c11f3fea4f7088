// The few agents that are seen large, drawn in full; their rows are left out where the crowd is drawn.

import * as THREE from "three";
import { bodyMaterial, standing, type Uniforms } from "./bodyshaders";
import { type Herd, Rows } from "./herd";
import { bodyGeometry, changed, pose, rowAttributes, type Shape } from "./shapes";
import type { Stage } from "./stage";

const LARGE = 24; // px that a body is long on the screen
const MOST = { software: 40, hardware: 400 };
const POINT = new THREE.Vector3();

export class Close {
  private readonly rows = new Rows();
  private readonly uniforms: Uniforms;
  private readonly mesh: THREE.Mesh<THREE.InstancedBufferGeometry>;
  private attributes = new Map<string, THREE.InstancedBufferAttribute>();
  private shape: Shape | null = null;
  private chosen: number[] = []; // rows, in order
  private readonly found: number[] = [];
  private far = new Float32Array(0); // of each row, where it was measured

  constructor(
    private readonly stage: Stage,
    private readonly herd: Herd,
    private readonly marked: () => void, // rows came to be left out, or no longer
  ) {
    this.uniforms = standing(stage);
    this.mesh = new THREE.Mesh(new THREE.InstancedBufferGeometry(), bodyMaterial(this.uniforms));
    this.mesh.frustumCulled = false;
    this.mesh.visible = false;
    this.mesh.renderOrder = 2;
    stage.scene.add(this.mesh);
    this.rows.reserve(MOST[stage.software ? "software" : "hardware"]);
  }

  forget(): void {
    this.shape = null;
  }

  show(shape: Shape | undefined, t: number): void {
    if (!shape) return;
    if (shape !== this.shape) this.build(shape);
    const before = this.chosen;
    this.chosen = this.near(t);
    const { rows, herd } = this;
    const same = before.length === this.chosen.length && before.every((row, k) => row === this.chosen[k]);
    if (!same) for (const row of before) if (row < herd.count) herd.rows.tone[4 * row + 3] = 255;
    let hidden = same;
    this.chosen.forEach((row, k) => {
      rows.copy(k, herd.rows, row);
      hidden &&= herd.rows.tone[4 * row + 3] === 0;
      for (let part = 0; part < 3; part++) rows.tone[4 * k + part] = herd.rows.tone[4 * row + part] as number;
      rows.tone[4 * k + 3] = 255;
      herd.rows.tone[4 * row + 3] = 0;
    });
    if (!hidden) this.marked();
    for (const attribute of this.attributes.values()) changed(attribute, this.chosen.length);
    this.mesh.geometry.instanceCount = this.chosen.length;
    this.mesh.visible = this.chosen.length > 0;
    this.uniforms.t.value = t;
    this.uniforms.focal.value = this.stage.focal;
  }

  dispose(): void {
    this.stage.scene.remove(this.mesh);
    this.mesh.geometry.dispose();
    (this.mesh.material as THREE.Material).dispose();
    (this.uniforms.poses.value as THREE.Texture | null)?.dispose();
  }

  /** The rows that are seen large, the nearest ones where they are many. */
  private near(t: number): number[] {
    const { herd, found } = this;
    if (this.far.length < herd.count) this.far = new Float32Array(herd.rows.capacity);
    const { far } = this;
    const eye = this.stage.camera.position;
    const most = MOST[this.stage.software || this.stage.slow ? "software" : "hardware"];
    found.length = 0;
    for (let row = 0; row < herd.count; row++) {
      herd.place(row, t, POINT);
      far[row] = POINT.distanceTo(eye);
      if ((far[row] as number) * LARGE < herd.size(row) * this.stage.focal) found.push(row);
    }
    if (found.length > most) found.sort((a, b) => (far[a] as number) - (far[b] as number)).length = most;
    return found.slice().sort((a, b) => a - b);
  }

  private build(shape: Shape): void {
    this.attributes = rowAttributes(this.rows);
    const geometry = bodyGeometry(shape);
    for (const [name, attribute] of this.attributes) geometry.setAttribute(name, attribute);
    this.mesh.geometry.dispose();
    this.mesh.geometry = geometry;
    pose(this.uniforms, shape);
    this.shape = shape;
  }
}
