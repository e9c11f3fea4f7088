// Many bodies of one shape in one draw call: skinned bodies that follow the bones of a rig, or rigid ones.

import * as THREE from "three";
import { bodyMaterial, standing, type Uniforms } from "./bodyshaders";
import { type Acting, Poser } from "./poser";
import type { Skin } from "./rig";
import { bodyGeometry, type Shape } from "./shapes";
import type { Stage } from "../stage";

export type Form = Shape | Skin;

export class Figure {
  readonly uniforms: Uniforms;
  readonly mesh: THREE.Mesh<THREE.InstancedBufferGeometry, THREE.Material>;
  form: Form | null = null;
  poser: Poser | null = null;

  constructor(private readonly stage: Stage) {
    this.uniforms = standing(stage);
    this.mesh = new THREE.Mesh(new THREE.InstancedBufferGeometry(), bodyMaterial(this.uniforms, false));
    this.mesh.frustumCulled = false;
    this.mesh.visible = false;
    this.mesh.renderOrder = 2;
    stage.scene.add(this.mesh);
  }

  /** Set the shape, with the rows of the agents. */
  take(form: Form, rows: Map<string, THREE.InstancedBufferAttribute>): void {
    const skinned = "rig" in form;
    const geometry = skinned ? instanced(form.geometry) : bodyGeometry(form);
    for (const [name, attribute] of rows) geometry.setAttribute(name, attribute);
    this.mesh.geometry.dispose();
    this.mesh.geometry = geometry;
    if (form === this.form) return;
    this.form = form;
    this.poser?.dispose();
    this.poser = skinned ? new Poser(this.stage.renderer, form) : null;
    this.mesh.material.dispose();
    this.mesh.material = bodyMaterial(this.uniforms, skinned);
    if (skinned) this.dress(form);
  }

  /** Draw the first `count` rows, or the `chosen` ones, `t` of the way to the frame, posed by their clips. */
  show(count: number, t: number, acting: Acting, chosen: readonly number[] | null): void {
    const { mesh, uniforms, poser } = this;
    mesh.geometry.instanceCount = count;
    mesh.visible = count > 0;
    uniforms.t.value = t;
    uniforms.focal.value = this.stage.focal;
    if (!poser || count === 0) return;
    poser.pose(acting, count, t, chosen);
    [uniforms.firstRow.value, uniforms.secondRow.value, uniforms.thirdRow.value] = poser.textures;
    uniforms.perRow.value = poser.agentsInARow;
    uniforms.gazes.value = poser.traits;
  }

  private dress({ bones, rig, targets, rest }: Skin): void {
    const { uniforms } = this;
    const first = rig.looks.length + Number(rig.leans);
    uniforms.bones.value = bones;
    uniforms.targetList.value = targets;
    uniforms.palette.value = rig.palette;
    uniforms.gazeTexels.value = first + Math.ceil(rig.traits / 3);
    uniforms.traitAt.value = first;
    uniforms.targets.value = rig.targets;
    uniforms.vertices.value = rest.length / 3;
  }

  dispose(): void {
    this.stage.scene.remove(this.mesh);
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
    this.poser?.dispose();
  }
}

/** Return the same attributes for instanced drawing. */
function instanced(from: THREE.BufferGeometry): THREE.InstancedBufferGeometry {
  const made = new THREE.InstancedBufferGeometry();
  for (const [name, attribute] of Object.entries(from.attributes)) made.setAttribute(name, attribute);
  made.setIndex(from.index);
  return made;
}
