// Lines and arrows with widths in pixels: instances of a quad between two ends on the screen. An arrow head is a stroke with a
// pointed end, a stroke of length 0 is a dot. A batch is one draw call for any number of strokes.

import * as THREE from "three";
import type { Stage } from "./stage";

const VERTEX = /* glsl */ `
attribute vec3 start;
attribute vec3 end;
attribute vec2 wide;
attribute vec4 tone;
attribute vec2 ends;
uniform vec2 size;
uniform float lift;
varying vec4 vTone;
varying float vAlong;
varying vec2 vDot;
void main() {
  vec4 a = modelViewMatrix * vec4(start, 1.0);
  vec4 b = modelViewMatrix * vec4(end, 1.0);
  float near = 0.51 * projectionMatrix[3][2];
  if (a.z > near && b.z > near) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); return; }
  if (a.z > near) a = mix(a, b, (a.z - near) / (a.z - b.z));
  if (b.z > near) b = mix(b, a, (b.z - near) / (b.z - a.z));
  vec4 p = projectionMatrix * a, q = projectionMatrix * b;
  vec2 way = (q.xy / q.w - p.xy / p.w) * size;
  float far = length(way);
  way = far > 1e-4 ? way / far : vec2(1.0, 0.0);
  float half_width = 0.5 * mix(wide.x, wide.y, position.x);
  vec4 here = position.x < 0.5 ? p : q;
  bool dot_ = far <= 1e-4;
  vDot = dot_ ? vec2(position.x * 2.0 - 1.0, position.y) : vec2(0.0);
  if (dot_) here.xy += way * vDot.x * half_width * 2.0 / size * here.w;
  here.xy += vec2(-way.y, way.x) * position.y * half_width * 2.0 / size * here.w;
  here.z -= lift * here.w;
  gl_Position = here;
  vTone = vec4(tone.rgb, tone.a * mix(ends.x, ends.y, position.x));
  vAlong = position.x * far * 0.5;
}`;

const FRAGMENT = /* glsl */ `
uniform float dash;
uniform float fade;
varying vec4 vTone;
varying float vAlong;
varying vec2 vDot;
void main() {
  if (dot(vDot, vDot) > 1.0) discard;
  if (dash > 0.0 && fract(vAlong / dash) > 0.55) discard;
  gl_FragColor = vec4(vTone.rgb, vTone.a * fade);
  #include <colorspace_fragment>
}`;

export interface Kind {
  dash?: number; // px
  through?: boolean; // drawn faintly where an object hides it
  order?: number;
}

export class Strokes {
  readonly object = new THREE.Group();
  count = 0;
  private readonly size = { value: new THREE.Vector2(1, 1) };
  private geometry = new THREE.InstancedBufferGeometry();
  private start = new Float32Array(0);
  private end = new Float32Array(0);
  private wide = new Float32Array(0);
  private tone = new Float32Array(0);
  private ends = new Float32Array(0);
  private readonly meshes: THREE.Mesh[];

  constructor(
    private readonly stage: Stage,
    kind: Kind = {},
  ) {
    const material = (through: boolean) =>
      new THREE.ShaderMaterial({
        vertexShader: VERTEX,
        fragmentShader: FRAGMENT,
        uniforms: {
          size: this.size,
          lift: { value: 2e-4 },
          dash: { value: kind.dash ?? 0 },
          fade: { value: through ? 0.22 : 1 },
        },
        transparent: true,
        depthWrite: false,
        depthTest: !through,
        side: THREE.DoubleSide,
      });
    this.meshes = (kind.through ? [true, false] : [false]).map((through) => {
      const mesh = new THREE.Mesh(this.geometry, material(through));
      mesh.frustumCulled = false;
      mesh.renderOrder = (kind.order ?? 10) + (through ? 0 : 1);
      this.object.add(mesh);
      return mesh;
    });
    this.object.visible = false;
    stage.scene.add(this.object);
    stage.onResize(() => this.size.value.set(stage.width, stage.height));
    this.size.value.set(stage.width, stage.height);
    this.reserve(64);
  }

  clear(): void {
    this.count = 0;
  }

  /** Add a stroke from a to b (x, y, z at the given indices), with widths in px at both ends and a colour (0..1). */
  add(
    a: ArrayLike<number>,
    ai: number,
    b: ArrayLike<number>,
    bi: number,
    wide: number,
    wideEnd: number,
    colour: THREE.Color,
    alpha = 1,
  ): void {
    if (this.count * 3 >= this.start.length) this.reserve(this.count * 2);
    const k = this.count++;
    for (let axis = 0; axis < 3; axis++) {
      this.start[3 * k + axis] = a[ai + axis] as number;
      this.end[3 * k + axis] = b[bi + axis] as number;
    }
    this.wide[2 * k] = wide;
    this.wide[2 * k + 1] = wideEnd;
    this.tone[4 * k] = colour.r;
    this.tone[4 * k + 1] = colour.g;
    this.tone[4 * k + 2] = colour.b;
    this.tone[4 * k + 3] = alpha;
    this.ends[2 * k] = 1;
    this.ends[2 * k + 1] = 1;
  }

  /** Fade the last stroke towards its end, down to this share of its colour. */
  pale(part: number): void {
    this.ends[2 * this.count - 1] = part;
  }

  /** Add an arrow from a to b: a shaft, and a head with a share `part` of the length. */
  arrow(a: ArrayLike<number>, b: ArrayLike<number>, wide: number, colour: THREE.Color, alpha = 1, part = 0.25): void {
    for (let axis = 0; axis < 3; axis++) NECK[axis] = (b[axis] as number) + ((a[axis] as number) - (b[axis] as number)) * part;
    this.add(a, 0, NECK, 0, wide, wide, colour, alpha);
    this.add(NECK, 0, b, 0, wide * 3.6, 0, colour, alpha);
  }

  /** Upload the added strokes for drawing. */
  done(): void {
    this.geometry.instanceCount = this.count;
    this.object.visible = this.count > 0;
    for (const attribute of Object.values(this.geometry.attributes)) {
      if (attribute instanceof THREE.InstancedBufferAttribute) {
        attribute.clearUpdateRanges();
        attribute.addUpdateRange(0, this.count * attribute.itemSize);
        attribute.needsUpdate = true;
      }
    }
    this.stage.wake();
  }

  dispose(): void {
    this.stage.scene.remove(this.object);
    this.geometry.dispose();
    for (const mesh of this.meshes) (mesh.material as THREE.Material).dispose();
  }

  private reserve(count: number): void {
    const grown = (old: Float32Array, size: number) => {
      const array = new Float32Array(count * size);
      array.set(old);
      return array;
    };
    this.start = grown(this.start, 3);
    this.end = grown(this.end, 3);
    this.wide = grown(this.wide, 2);
    this.tone = grown(this.tone, 4);
    this.ends = grown(this.ends, 2);
    this.geometry.dispose();
    const geometry = new THREE.InstancedBufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array([0, -1, 0, 1, -1, 0, 1, 1, 0, 0, 1, 0]), 3));
    geometry.setIndex([0, 1, 2, 0, 2, 3]);
    const sizes: [string, Float32Array, number][] = [
      ["start", this.start, 3],
      ["end", this.end, 3],
      ["wide", this.wide, 2],
      ["tone", this.tone, 4],
      ["ends", this.ends, 2],
    ];
    for (const [name, array, size] of sizes) geometry.setAttribute(name, new THREE.InstancedBufferAttribute(array, size));
    geometry.instanceCount = 0;
    this.geometry = geometry;
    for (const mesh of this.meshes) mesh.geometry = geometry;
  }
}

const NECK = new Float32Array(3);
