// Bodies: one draw call for each body of a species. They are posed by their clips and interpolated between two frames. Each body
// has a soft shadow, so that it stands on its ground. Near bodies are drawn in full detail.

import * as THREE from "three";
import type { Packet } from "../../protocol";
import { shadowMaterial, square } from "./bodyshaders";
import { Close } from "./close";
import { Figure, type Form } from "./figure";
import type { Herd } from "../herds/herd";
import type { Herds } from "../herds/herds";
import { forgetRig, type Rigged, rigOf } from "./rig";
import { changed, rowAttributes } from "./shapes";
import { speck } from "./speck";
import type { Stage } from "../stage";

const CROWD = { software: 3000, hardware: 120_000 }; // number of agents from which each is drawn as a speck

const MANY = 2000;

type Level = "fine" | "low" | "speck";

export class Bodies {
  private readonly rigs = new Map<string, { made: Rigged; levels: Record<Level, Form> }>(); // by body key
  private readonly drawn = new Map<string, Drawn>();

  constructor(
    private readonly stage: Stage,
    private readonly herds: Herds,
  ) {
    herds.onPeople(() => this.people());
    herds.onFrame(() => this.refresh());
    stage.add(() => this.place());
  }

  /** `rig:KEY`: a body of a species. */
  take(packet: Packet): void {
    const key = packet.slot.slice(packet.slot.indexOf(":") + 1);
    const made = rigOf(packet);
    const before = this.rigs.get(key);
    const { low, fine } = made;
    const still = speck(low.trunk.length ? low.trunk : low.rest);
    this.rigs.set(key, { made, levels: { low, fine, speck: still } });
    this.herds.acting(key, low.rig);
    this.drawn.get(key)?.forget();
    if (before) forgetRig(before.made);
    this.refresh();
    this.stage.wake();
  }

  /** Return the drawn figure of an agent, with its index in it: for tests. */
  posed(species: string, row: number): { figure: Figure; place: number } | null {
    const one = this.drawn.get(species);
    if (one) return one.posed(row);
    const id = this.herds.byName.get(species)?.ids[row];
    for (const each of this.drawn.values()) {
      const own = each.herd.species.name === species && id !== undefined ? each.herd.row(id) : -1;
      if (own >= 0) return each.posed(own);
    }
    return null;
  }

  /** Upload the colours after a change. */
  recolour(): void {
    for (const each of this.drawn.values()) each.recolour();
    this.stage.wake();
  }

  private people(): void {
    for (const each of this.drawn.values()) each.dispose();
    this.drawn.clear();
    for (const [key, herd] of this.herds.byBody) this.drawn.set(key, new Drawn(this.stage, herd));
  }

  private refresh(): void {
    for (const each of this.drawn.values()) each.refresh();
  }

  /** Choose the level of detail of each species by its size on the screen. */
  private place(): boolean {
    const kind = this.stage.software || this.stage.slow ? "software" : "hardware";
    const crowd = this.herds.count;
    for (const each of this.drawn.values()) {
      const levels = this.rigs.get(each.herd.key)?.levels;
      if (!levels) continue;
      const level: Level = crowd > CROWD[kind] ? "speck" : "low";
      each.show(levels[level], this.herds.t, level !== "speck");
      each.close.show(levels.fine, this.herds.t);
    }
    return false;
  }
}

/** The drawn agents of one body. */
class Drawn {
  readonly close: Close;
  private readonly figure: Figure;
  private readonly shadow: THREE.Mesh<THREE.InstancedBufferGeometry>;
  private version = -1;
  private instanced = new Map<string, THREE.InstancedBufferAttribute>();

  constructor(
    private readonly stage: Stage,
    readonly herd: Herd,
  ) {
    this.figure = new Figure(stage);
    this.shadow = new THREE.Mesh(new THREE.InstancedBufferGeometry(), shadowMaterial(this.figure.uniforms));
    this.shadow.renderOrder = 1;
    this.close = new Close(stage, herd, () => this.recolour());
    this.shadow.frustumCulled = false;
    this.shadow.visible = false;
    stage.scene.add(this.shadow);
  }

  forget(): void {
    this.figure.form = null;
    this.close.forget();
  }

  refresh(): void {
    for (const [, attribute] of this.instanced) changed(attribute, this.herd.count);
  }

  recolour(): void {
    const tone = this.instanced.get("tone");
    if (tone) changed(tone, this.herd.count);
  }

  posed(row: number): { figure: Figure; place: number } {
    return this.close.posed(row) ?? { figure: this.figure, place: row };
  }

  show(form: Form, t: number, shadow: boolean): void {
    const { figure, herd } = this;
    if (form !== figure.form || this.version !== herd.rows.version) this.build(form);
    figure.uniforms.least.value = herd.count > MANY ? 4 : 6; // px: minimum length of a body on the screen
    figure.show(herd.count, t, herd, null);
    this.shadow.geometry.instanceCount = herd.count;
    this.shadow.visible = shadow && herd.count > 0;
  }

  dispose(): void {
    this.close.dispose();
    this.figure.dispose();
    this.stage.scene.remove(this.shadow);
    this.shadow.geometry.dispose();
    (this.shadow.material as THREE.Material).dispose();
  }

  private build(form: Form): void {
    this.instanced = rowAttributes(this.herd.rows);
    this.figure.take(form, this.instanced);
    const shadow = square();
    for (const [name, attribute] of this.instanced) shadow.setAttribute(name, attribute);
    this.shadow.geometry.dispose();
    this.shadow.geometry = shadow;
    if ("rig" in form) this.figure.uniforms.shade.value.set(Math.max(1.5 * form.half[0], 0.1), Math.max(1.5 * form.half[1], 0.1));
    this.version = this.herd.rows.version;
    this.refresh();
  }
}
