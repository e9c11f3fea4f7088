// Poses agents on the graphics card: computes the matrices of all their bones as three textures for the drawing of bodies.

import * as THREE from "three";
import type { Feet } from "../herds/feet";
import type { Gaze } from "../herds/gaze";
import type { Offsets } from "../herds/offsets";
import { Pass } from "./passes";
import type { Plays } from "../herds/plays";
import { BENT, BONES, FLAT, JOINTS, LEGS, SOLES } from "./poseshaders";
import { type Skin, WIDE } from "./rig";

const LONGEST = 8192; // maximum side length of the textures in texels

/** What the bodies of a species can do. */
export interface Acting {
  plays: Plays;
  feet: Feet;
  gaze: Gaze;
  offsets: Offsets;
}

/** Rows of numbers as a texture that grows, four numbers per texel. */
class Lines {
  texture = new THREE.DataTexture(new Float32Array(4), 1, 1, THREE.RGBAFormat, THREE.FloatType);

  /** Write the first `count` rows, or the `chosen` ones, of `width` numbers each. */
  fill(data: Float32Array, width: number, count: number, chosen: readonly number[] | null): void {
    const rows = Math.max(Math.ceil((count * width) / (4 * WIDE)), 1);
    if (this.texture.image.height < rows || this.texture.image.width !== WIDE) {
      this.texture.dispose();
      const room = Math.ceil(rows * 1.3);
      this.texture = new THREE.DataTexture(new Float32Array(4 * WIDE * room), WIDE, room, THREE.RGBAFormat, THREE.FloatType);
    }
    const into = this.texture.image.data as unknown as Float32Array;
    if (chosen) {
      for (const [k, row] of chosen.entries()) into.set(data.subarray(row * width, (row + 1) * width), k * width);
    } else into.set(data.subarray(0, count * width));
    this.texture.needsUpdate = true;
  }
}

export class Poser {
  private readonly joints: Pass;
  private readonly legs: Pass | null;
  private readonly bent: Pass | null;
  private readonly soles: Pass | null;
  private readonly flat: Pass | null;
  private readonly bones: Pass;
  private readonly plays = new Lines();
  private readonly stances = new Lines();
  private readonly gazes = new Lines();
  private readonly offsets = new Lines();
  private rows = 0; // capacity in rows of agents
  private perRow = 1;
  private known = "";
  private filled = "";

  constructor(
    private readonly renderer: THREE.WebGLRenderer,
    private readonly skin: Skin,
  ) {
    const { rig } = skin;
    const all = { table: rig.table, joints: rig.joints, texels: rig.texels, base: rig.base, perRow: 1, count: 0, t: 1, legs: 0 };
    const gaze = {
      looks: rig.looks.length,
      leans: Number(rig.leans),
      lookAt: rig.lookAt,
      gazeTexels: rig.looks.length + Number(rig.leans) + Math.ceil(rig.traits / 3),
      targets: rig.targets,
      sizes: rig.scales,
      scaleAt: rig.scaleAt,
    };
    const clips = {
      samples: rig.samples,
      clips: rig.clips,
      groups: rig.groups,
      machines: rig.machines.length + Number(rig.idle !== null),
      plays: null,
      ...gaze,
    };
    const legs = {
      ...gaze,
      offsets: null,
      offsetJoints: 0,
      legAt: rig.legAt,
      unitLength: rig.length,
      ...rig.bending,
      footTexels: rig.flat ? 4 : 2,
    };
    this.joints = new Pass(renderer, JOINTS, 4, rig.joints, { ...all, ...clips });
    this.legs = rig.legs ? new Pass(renderer, LEGS, 3, rig.legs, { ...all, ...legs, legs: rig.legs }) : null;
    this.bent = rig.legs ? new Pass(renderer, BENT, 3, rig.legs, { ...all, ...legs, legs: rig.legs }) : null;
    this.soles = rig.flat ? new Pass(renderer, SOLES, 3, rig.legs, { ...all, ...legs, legs: rig.legs }) : null;
    this.flat = rig.flat ? new Pass(renderer, FLAT, 2, 2 * rig.legs, { ...all, ...legs, legs: rig.legs }) : null;
    this.bones = new Pass(renderer, BONES, 3, Math.max(skin.bones, 1), { ...all, ...legs, bones: skin.list });
  }

  /** Return the maximum number of agents on this graphics card. */
  get most(): number {
    return Math.floor(this.side / this.items) * this.side;
  }

  get textures(): THREE.Texture[] {
    return this.bones.textures;
  }

  /** Return the looks, leans and traits of agents in their last pose. */
  get traits(): THREE.Texture {
    return this.gazes.texture;
  }

  get agentsInARow(): number {
    return this.perRow;
  }

  private get items(): number {
    return Math.max(this.skin.bones, this.skin.rig.joints, 2 * this.skin.rig.legs, 1);
  }

  private get passes(): (Pass | null)[] {
    return [this.joints, this.legs, this.bent, this.soles, this.flat, this.bones];
  }

  private get side(): number {
    return Math.min(this.renderer.capabilities.maxTextureSize, LONGEST);
  }

  /** Pose agents at `t` of the way: the first `count` rows, or the `chosen` ones. Does nothing if nothing has
   * changed. */
  pose({ plays, feet, gaze, offsets }: Acting, count: number, t: number, chosen: readonly number[] | null): void {
    const pose = `${plays.version} ${feet.version} ${gaze.version} ${offsets.version} ${count} ${chosen ? chosen.join() : ""}`;
    const now = `${pose} ${t}`;
    if (now === this.known || count === 0 || this.skin.bones === 0) return;
    this.known = now;
    this.room(count);
    if (pose !== this.filled) {
      this.filled = pose;
      this.plays.fill(plays.data, plays.width, count, chosen);
      if (gaze.width) this.gazes.fill(gaze.data, gaze.width, count, chosen);
      if (offsets.width) this.offsets.fill(offsets.data, offsets.width, count, chosen);
      if (feet.hasData) this.stances.fill(feet.data, feet.width, count, chosen);
    }
    this.run({ count, perRow: this.perRow, t, offsetJoints: offsets.joints.length }, feet.hasData);
  }

  /** Return the matrices of all bones of an agent in its last pose, row by row: for tests. */
  all(agent: number): number[][] {
    if (agent < 0 || agent >= this.rows) return [];
    const [x, y] = [agent % this.perRow, Math.floor(agent / this.perRow)];
    const rows = [0, 1, 2].map((row) => this.bones.read(row, x, y));
    return Array.from({ length: this.skin.bones }, (_, bone) => rows.flatMap((row) => [...row.subarray(4 * bone, 4 * bone + 4)]));
  }

  dispose(): void {
    for (const pass of this.passes) pass?.dispose();
    for (const lines of [this.plays, this.stances, this.gazes, this.offsets]) lines.texture.dispose();
  }

  private run(values: { count: number; perRow: number; t: number; offsetJoints: number }, stand: boolean): void {
    this.joints.run({ ...values, plays: this.plays.texture, gazes: this.gazes.texture });
    const [moves, turns, scales, shears] = this.joints.textures;
    const local = { ...values, moves, turns, scales, shears, gazes: this.gazes.texture, offsets: this.offsets.texture };
    const { legs, bent } = this;
    if (!legs || !bent || !stand) {
      this.bones.run({ ...local, legs: 0 });
      return;
    }
    legs.run(local);
    const [hips, knees, feet] = legs.textures;
    const standing = { hips, knees, stances: this.stances.texture };
    this.soles?.run(local);
    const [ankles, archUps, soleUps] = this.soles?.textures ?? [];
    const ends = { ...values, ...standing, feet, ankles, archUps, soleUps };
    bent.run(ends);
    const [legTurns, kneeTurns, footMoves] = bent.textures;
    this.flat?.run({ ...ends, footMoves });
    const [soleTurns, soleMoves] = this.flat?.textures ?? [];
    const bends = { legTurns, kneeTurns, footMoves, soleTurns, soleMoves };
    this.bones.run({ ...local, ...standing, ...bends, legs: this.skin.rig.legs });
  }

  private room(count: number): void {
    if (count <= this.rows) return;
    this.rows = Math.ceil(count * 1.3) + 8;
    this.perRow = Math.max(Math.min(Math.floor(this.side / this.items), Math.ceil(Math.sqrt(this.rows))), 1);
    for (const pass of this.passes) pass?.room(this.perRow, Math.ceil(this.rows / this.perRow));
  }
}
