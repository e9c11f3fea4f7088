// A pass computes a value for each item (joint, leg, bone) of each agent, one pixel each, in textures that the next pass
// reads.

import * as THREE from "three";
import { POSE_VERTEX } from "./poseshaders";

const CAMERA = new THREE.OrthographicCamera(-1, 1, 1, -1, 0, 1);

export type Values = Record<string, unknown>;

export class Pass {
  private readonly scene = new THREE.Scene();
  private readonly material: THREE.ShaderMaterial;
  private readonly quad: THREE.Mesh;
  private target: THREE.WebGLRenderTarget | null = null;

  constructor(
    private readonly renderer: THREE.WebGLRenderer,
    shader: string,
    private readonly outputs: number,
    readonly items: number,
    values: Values,
  ) {
    const uniforms = Object.fromEntries(Object.entries({ ...values, items }).map(([name, value]) => [name, { value }]));
    this.material = new THREE.ShaderMaterial({
      vertexShader: POSE_VERTEX,
      fragmentShader: shader,
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

  get textures(): THREE.Texture[] {
    return this.target?.textures ?? [];
  }

  /** Make room for agents: `perRow` in each row of the texture, in so many rows. */
  room(perRow: number, rows: number): void {
    this.target?.dispose();
    this.target = new THREE.WebGLRenderTarget(perRow * this.items, rows, {
      count: this.outputs,
      type: THREE.FloatType,
      format: THREE.RGBAFormat,
      minFilter: THREE.NearestFilter,
      magFilter: THREE.NearestFilter,
      depthBuffer: false,
    });
  }

  run(values: Values): void {
    for (const [name, value] of Object.entries(values)) {
      const uniform = this.material.uniforms[name];
      if (uniform) uniform.value = value;
      else this.material.uniforms[name] = { value };
    }
    const before = this.renderer.getRenderTarget();
    this.renderer.setRenderTarget(this.target);
    this.renderer.render(this.scene, CAMERA);
    this.renderer.setRenderTarget(before);
  }

  /** Return one output of all items of an agent: for tests. */
  read(output: number, x: number, y: number): Float32Array {
    const pixels = new Float32Array(4 * this.items);
    if (this.target) {
      this.renderer.readRenderTargetPixels(this.target, x * this.items, y, this.items, 1, pixels, 0, output);
    }
    return pixels;
  }

  dispose(): void {
    this.target?.dispose();
    this.material.dispose();
    this.quad.geometry.dispose();
  }
}
