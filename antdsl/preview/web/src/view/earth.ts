// The material of ground, stones and dug solids: matt, with a grain that shows the scale and fades out at a distance, where it
// would flicker.

import * as THREE from "three";
import type { Sight } from "./sight";

const GRAIN = /* glsl */ `
float grainHash(vec3 p) {
  p = fract(p * vec3(0.1031, 0.1030, 0.0973));
  p += dot(p, p.yxz + 33.33);
  return fract((p.x + p.y) * p.z);
}
float grainNoise(vec3 p) {
  vec3 i = floor(p), f = fract(p);
  f = f * f * (3.0 - 2.0 * f);
  vec4 low = vec4(grainHash(i), grainHash(i + vec3(1, 0, 0)), grainHash(i + vec3(0, 1, 0)), grainHash(i + vec3(1, 1, 0)));
  i.z += 1.0;
  vec4 high = vec4(grainHash(i), grainHash(i + vec3(1, 0, 0)), grainHash(i + vec3(0, 1, 0)), grainHash(i + vec3(1, 1, 0)));
  vec4 z = mix(low, high, f.z);
  vec2 y = mix(z.xy, z.zw, f.y);
  return mix(y.x, y.y, f.x);
}
float grain(vec3 p, float size) {
  vec3 q = p / size;
  float seen = 1.0 - smoothstep(0.25, 0.7, max(length(dFdx(q)), length(dFdy(q))));
  return seen > 0.0 ? seen * (grainNoise(q) - 0.5) : 0.0;
}`;

export type Stuff = "ground" | "shape" | "obstacle" | "earth";

/** Return a material of the palette that follows the theme; all but the ground can be transparent. `grains`: grain size in mm. */
export function earth({ stage, store }: Sight, stuff: Stuff, grains: { value: number }): THREE.MeshLambertMaterial {
  const material = new THREE.MeshLambertMaterial({ side: THREE.DoubleSide });
  const dress = () => material.color.copy(stage.palette[stuff]);
  dress();
  stage.palette.onChange(dress);
  store.on("glass", () => {
    material.transparent = store.now.glass && stuff !== "ground";
    material.opacity = material.transparent ? 0.3 : 1;
    material.depthWrite = !material.transparent;
    material.needsUpdate = true;
    stage.wake();
  });
  if (stage.software) return material; // in software, the grain would take longer than all other drawing
  material.onBeforeCompile = (shader) => {
    shader.uniforms.grains = grains;
    shader.vertexShader = shader.vertexShader
      .replace("#include <common>", "#include <common>\nvarying vec3 vPlace;")
      .replace("#include <begin_vertex>", "#include <begin_vertex>\nvPlace = (modelMatrix * vec4(position, 1.0)).xyz;");
    shader.fragmentShader = shader.fragmentShader
      .replace("#include <common>", `#include <common>\nvarying vec3 vPlace;\nuniform float grains;${GRAIN}`)
      .replace(
        "#include <color_fragment>",
        `#include <color_fragment>
        float rough = 0.16 * grain(vPlace, grains) + 0.14 * grain(vPlace, grains * 6.3) + 0.12 * grain(vPlace, grains * 37.0);
        diffuseColor.rgb *= 1.0 + rough;`,
      );
  };
  return material;
}
