// Poses agents on the graphics card: the matrices of all bones of all of them, as three textures that bodies are drawn by.

import * as THREE from "three";
import { type Plays, TEXELS } from "./plays";
import { POSE_FRAGMENT, POSE_VERTEX } from "./poseshaders";
import { type Skin, WIDE } from "./rig";

const LONGEST = 8192; // texels that a side of the textures has at most
const CAMERA = new THREE.OrthographicCamera(-1, 1, 1, -1, 0, 1);

export class Poser {
  private readonly scene = new THREE.Scene();
  private readonly material: THREE.ShaderMaterial;
  private readonly quad: THREE.Mesh;
  private target: THREE.WebGLRenderTarget | null = null;
  private texture = new THREE.DataTexture(new Float32Array(4), 1, 1, THREE.RGBAFormat, THREE.FloatType);
  private rows = 0; // of agents, in the textures
  private perRow = 1;
  private known = "";
  private filled = "";

  constructor(
    private readonly renderer: THREE.WebGLRenderer,
    private readonly skin: Skin,
  ) {
    const { rig } = skin;
    const fixed = { samples: rig.samples, table: rig.table, bones: skin.list, base: rig.base };
    const numbers = { joints: rig.joints, texels: rig.texels, boneCount: skin.bones, clips: rig.clips, groups: rig.groups };
    const set = { ...fixed, ...numbers, plays: this.texture, machines: rig.machines.length, perRow: 1, count: 0, t: 1 };
    const uniforms = Object.fromEntries(Object.entries(set).map(([name, value]) => [name, { value }]));
    this.material = new THREE.ShaderMaterial({
      vertexShader: POSE_VERTEX,
      fragmentShader: POSE_FRAGMENT,
      uniforms,
      glslVersion: THREE.GLSL3,
      depthTest: false,
      depthWrite: false,
      blending: THREE.NoBlending,
    });
    this.quad = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), this.material);
    this.quad.frustumCulled = false;
    this.scene.add(this.quad);
  }

  /** How many agents there is room for on this graphics card. */
  get most(): number {
    const side = this.side;
    return Math.floor(side / Math.max(this.skin.bones, 1)) * side;
  }

  get textures(): THREE.Texture[] {
    return this.target?.textures ?? [];
  }

  get agentsInARow(): number {
    return this.perRow;
  }

  private get side(): number {
    return Math.min(this.renderer.capabilities.maxTextureSize, LONGEST);
  }

  /** Pose agents as they are `t` of the way: the first `count` rows, or the `chosen` ones. Nothing is done where nothing has
   * changed. */
  pose(plays: Plays, count: number, t: number, chosen: readonly number[] | null): void {
    const now = `${plays.version} ${count} ${t} ${chosen ? chosen.join() : ""}`;
    if (now === this.known || count === 0 || this.skin.bones === 0) return;
    this.known = now;
    this.room(count);
    const told = `${plays.version} ${count} ${chosen ? chosen.join() : ""}`;
    if (told !== this.filled) this.fill(plays, count, chosen);
    this.filled = told;
    const { uniforms } = this.material;
    (uniforms.count as THREE.IUniform).value = count;
    (uniforms.perRow as THREE.IUniform).value = this.perRow;
    (uniforms.t as THREE.IUniform).value = t;
    const before = this.renderer.getRenderTarget();
    this.renderer.setRenderTarget(this.target);
    this.renderer.render(this.scene, CAMERA);
    this.renderer.setRenderTarget(before);
  }

  /** The matrices of all bones of an agent as it was posed last, each row by row: for tests. */
  all(agent: number): number[][] {
    const { target, skin } = this;
    if (!target || agent < 0) return [];
    const [x, y] = [(agent % this.perRow) * skin.bones, Math.floor(agent / this.perRow)];
    const rows = [0, 1, 2].map((row) => {
      const pixels = new Float32Array(4 * skin.bones);
      this.renderer.readRenderTargetPixels(target, x, y, skin.bones, 1, pixels, 0, row);
      return pixels;
    });
    return Array.from({ length: skin.bones }, (_, bone) => rows.flatMap((row) => [...row.subarray(4 * bone, 4 * bone + 4)]));
  }

  dispose(): void {
    this.target?.dispose();
    this.texture.dispose();
    this.material.dispose();
    this.quad.geometry.dispose();
  }

  private room(count: number): void {
    if (count <= this.rows && this.target) return;
    this.rows = Math.min(Math.ceil(count * 1.3) + 8, Math.max(this.most, count));
    this.perRow = Math.max(Math.min(Math.floor(this.side / this.skin.bones), Math.ceil(Math.sqrt(this.rows))), 1);
    this.target?.dispose();
    this.target = new THREE.WebGLRenderTarget(this.perRow * this.skin.bones, Math.ceil(this.rows / this.perRow), {
      count: 3,
      type: THREE.FloatType,
      format: THREE.RGBAFormat,
      minFilter: THREE.NearestFilter,
      magFilter: THREE.NearestFilter,
      depthBuffer: false,
    });
  }

  private fill(plays: Plays, count: number, chosen: readonly number[] | null): void {
    const { width } = plays;
    const rows = Math.max(Math.ceil((count * TEXELS * plays.machines.length) / WIDE), 1);
    if (this.texture.image.height < rows || this.texture.image.width !== WIDE) {
      this.texture.dispose();
      const room = Math.ceil(rows * 1.3);
      this.texture = new THREE.DataTexture(new Float32Array(4 * WIDE * room), WIDE, room, THREE.RGBAFormat, THREE.FloatType);
      (this.material.uniforms.plays as THREE.IUniform).value = this.texture;
    }
    const into = this.texture.image.data as unknown as Float32Array;
    if (chosen) {
      for (const [k, row] of chosen.entries()) into.set(plays.data.subarray(row * width, (row + 1) * width), k * width);
    } else into.set(plays.data.subarray(0, count * width));
    this.texture.needsUpdate = true;
  }
}
