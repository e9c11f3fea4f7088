// Bodies: one call to draw for each species. Poses of the walk lie in a texture; turning and the way between two frames is done
// where it is drawn. Below each body lies a soft shadow, so that it stands on its ground. Those near by are drawn in full.

import * as THREE from "three";
import type { NumberArray, Packet } from "../protocol";
import { bodyMaterial, shadowMaterial, square, standing, type Uniforms } from "./bodyshaders";
import { Close } from "./close";
import type { Herd } from "./herd";
import type { Herds } from "./herds";
import { bodyGeometry, changed, pose, rowAttributes, type Shape } from "./shapes";
import { speck } from "./speck";
import type { Stage } from "./stage";

const CROWD = { software: 3000, hardware: 120_000 }; // agents from which on each is a speck

const MANY = 2000;

type Level = "fine" | "low" | "speck";

export class Bodies {
  private readonly shapes = new Map<string, Map<Level, Shape>>();
  private readonly drawn = new Map<string, Drawn>();

  constructor(
    private readonly stage: Stage,
    private readonly herds: Herds,
  ) {
    herds.onPeople(() => this.people());
    herds.onFrame(() => this.refresh());
    stage.add(() => this.place());
  }

  /** `body:NAME`, or `body:NAME:fine` for close-ups. */
  take(packet: Packet): void {
    const [, name = "", fine] = packet.slot.split(":");
    const shape = shapeOf(packet);
    const levels = this.shapes.get(name) ?? new Map<Level, Shape>();
    levels.set(fine ? "fine" : "low", shape);
    if (!fine) levels.set("speck", speck(shape));
    this.shapes.set(name, levels);
    this.herds.walk(name, Number(packet.header.stride) || 1);
    for (const each of this.drawn.values()) each.forget();
    this.stage.wake();
  }

  /** Colours were changed: hand them over again. */
  recolour(): void {
    for (const each of this.drawn.values()) each.recolour();
    this.stage.wake();
  }

  private people(): void {
    for (const each of this.drawn.values()) each.dispose();
    this.drawn.clear();
    for (const [name, herd] of this.herds.byName) this.drawn.set(name, new Drawn(this.stage, herd));
  }

  private refresh(): void {
    for (const each of this.drawn.values()) each.refresh();
  }

  /** Choose how fine each species is drawn, by how large it is seen where one looks. */
  private place(): boolean {
    const kind = this.stage.software || this.stage.slow ? "software" : "hardware";
    const crowd = this.herds.count;
    for (const each of this.drawn.values()) {
      const levels = this.shapes.get(each.herd.species.body);
      if (!levels) continue;
      const level: Level = crowd > CROWD[kind] ? "speck" : "low";
      const shape = levels.get(level);
      if (shape) each.show(shape, this.herds.t, level !== "speck");
      each.close.show(levels.get("fine"), this.herds.t);
    }
    return false;
  }
}

/** One species as it is drawn. */
class Drawn {
  private readonly uniforms: Uniforms;
  readonly close: Close;
  private readonly body: THREE.Mesh;
  private readonly shadow: THREE.Mesh;
  private shape: Shape | null = null;
  private version = -1;
  private instanced = new Map<string, THREE.InstancedBufferAttribute>();

  constructor(
    private readonly stage: Stage,
    readonly herd: Herd,
  ) {
    this.uniforms = standing(stage);
    this.body = new THREE.Mesh(new THREE.InstancedBufferGeometry(), bodyMaterial(this.uniforms));
    this.shadow = new THREE.Mesh(new THREE.InstancedBufferGeometry(), shadowMaterial(this.uniforms));
    this.shadow.renderOrder = 1;
    this.body.renderOrder = 2;
    this.close = new Close(stage, herd, () => this.recolour());
    for (const mesh of [this.body, this.shadow]) {
      mesh.frustumCulled = false;
      mesh.visible = false;
      stage.scene.add(mesh);
    }
  }

  forget(): void {
    this.shape = null;
    this.close.forget();
  }

  refresh(): void {
    const count = this.herd.count;
    for (const [, attribute] of this.instanced) changed(attribute, count);
    for (const mesh of [this.body, this.shadow]) (mesh.geometry as THREE.InstancedBufferGeometry).instanceCount = count;
  }

  recolour(): void {
    const tone = this.instanced.get("tone");
    if (tone) changed(tone, this.herd.count);
  }

  show(shape: Shape, t: number, shadow: boolean): void {
    if (shape !== this.shape || this.version !== this.herd.rows.version) this.build(shape);
    this.uniforms.t.value = t;
    this.uniforms.focal.value = this.stage.focal;
    this.uniforms.least.value = this.herd.count > MANY ? 4 : 6; // px: so long a body is seen from however far
    this.body.visible = this.herd.count > 0;
    this.shadow.visible = shadow && this.herd.count > 0;
  }

  dispose(): void {
    this.close.dispose();
    for (const mesh of [this.body, this.shadow]) {
      this.stage.scene.remove(mesh);
      mesh.geometry.dispose();
      (mesh.material as THREE.Material).dispose();
    }
    (this.uniforms.poses.value as THREE.Texture | null)?.dispose();
  }

  private build(shape: Shape): void {
    this.instanced = rowAttributes(this.herd.rows);
    const body = bodyGeometry(shape);
    const shadow = square();
    for (const [mesh, geometry] of [
      [this.body, body],
      [this.shadow, shadow],
    ] as const) {
      for (const [name, attribute] of this.instanced) geometry.setAttribute(name, attribute);
      geometry.instanceCount = this.herd.count;
      mesh.geometry.dispose();
      mesh.geometry = geometry;
    }
    if (shape !== this.shape) pose(this.uniforms, shape);
    this.shape = shape;
    this.version = this.herd.rows.version;
    this.refresh();
  }
}

function shapeOf(packet: Packet): Shape {
  const take = (name: string) => packet.arrays.get(name) as NumberArray;
  const normal = take("normal") as Float32Array;
  const poses = take("poses") as Float32Array;
  return {
    poses,
    count: poses.length / normal.length,
    normal,
    face: Uint32Array.from(take("face")),
    tint: take("tint") as Float32Array,
  };
}
