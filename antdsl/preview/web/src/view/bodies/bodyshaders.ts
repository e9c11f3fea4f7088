// The shaders of bodies, their shadows and the rings around selected agents. All read the same rows, see `Rows`.

import * as THREE from "three";
import { TRAIT } from "./poseshaders";
import { WIDE } from "./rig";
import type { Stage } from "../stage";

/** The pose of a row: `here`, the rotation `turned` (ahead, up, aside), and `long`, the body's length, at least a few px. */
const STAND = /* glsl */ `
attribute vec3 placeA;
attribute vec3 placeB;
attribute vec4 headA;
attribute vec4 headB;
attribute vec4 upA;
attribute vec4 upB;
attribute float size;
attribute vec4 tone;
uniform float t;
uniform float focal;
uniform float least;
vec3 here;
mat3 turned;
float bodyLength;
void stand() {
  here = mix(placeA, placeB, t);
  vec3 up = mix(upA.xyz, upB.xyz, t);
  up = dot(up, up) > 1e-6 ? normalize(up) : vec3(0.0, 1.0, 0.0);
  vec3 ahead = mix(headA.xyz, headB.xyz, t);
  ahead -= up * dot(ahead, up);
  if (dot(ahead, ahead) < 1e-6) ahead = cross(up, abs(up.x) < 0.9 ? vec3(1.0, 0.0, 0.0) : vec3(0.0, 0.0, 1.0));
  ahead = normalize(ahead);
  turned = mat3(ahead, up, cross(ahead, up));
  float depth = max(-(modelViewMatrix * vec4(here, 1.0)).z, 1e-6);
  bodyLength = max(size, least * depth / focal);
}`;

/** A rigid shape in the agent's colour. */
const STILL = /* glsl */ `
vec4 painted() { return vec4(1.0); }
bool bare() { return false; }
void posed(out vec3 place, out vec3 across) {
  place = position;
  across = normal;
}`;

/** Blend shapes, then linear skinning: the mean of the matrices of up to four bones. Normals use its cofactors, so scales keep them right. */
const SKIN = /* glsl */ `
attribute vec4 colour;
attribute vec4 bone;
attribute vec4 weight;
attribute vec3 worn; // the layers that show it; the trait that sets its colour, or -1, and the first of its colours
attribute float wears;
uniform highp sampler2D firstRow;
uniform highp sampler2D secondRow;
uniform highp sampler2D thirdRow;
uniform int bones;
uniform int perRow;
uniform highp sampler2D gazes;
uniform highp sampler2D targetList;
uniform highp sampler2D palette;
uniform int gazeTexels;
uniform int traitAt;
uniform int targets;
uniform int vertices;
${TRAIT}
vec4 listed(highp sampler2D list, int number) { return texelFetch(list, ivec2(number % ${WIDE}, number / ${WIDE}), 0); }
float trait(int number) { return traitOf(gazes, gl_InstanceID, gazeTexels, traitAt, number, t); }
vec4 painted() {
  if (worn.y < 0.0) return vec4(colour.rgb * colour.rgb, colour.a);
  float place = trait(int(worn.y + 0.5)), whole = floor(place);
  int first = int(worn.z + whole + 0.5);
  vec3 from = listed(palette, first).rgb;
  return vec4(place > whole ? mix(from, listed(palette, first + 1).rgb, place - whole) : from, colour.a);
}
bool bare() { return worn.x > 0.5 && (uint(worn.x + 0.5) & uint(wears + 0.5)) == 0u; } // part of a layer that the agent does not wear
void posed(out vec3 place, out vec3 across) {
  int left = (gl_InstanceID % perRow) * bones;
  int row = gl_InstanceID / perRow;
  vec4 a = vec4(0.0), b = vec4(0.0), c = vec4(0.0);
  for (int k = 0; k < 4; k++) {
    if (weight[k] <= 0.0) continue;
    ivec2 here = ivec2(left + int(bone[k] + 0.5), row);
    a += weight[k] * texelFetch(firstRow, here, 0);
    b += weight[k] * texelFetch(secondRow, here, 0);
    c += weight[k] * texelFetch(thirdRow, here, 0);
  }
  vec3 point = position, upright = normal;
  for (int k = 0; k < targets; k++) {
    float weight = trait(k);
    if (weight == 0.0) continue;
    int here = 2 * (k * vertices + gl_VertexID);
    point += weight * listed(targetList, here).xyz;
    upright += weight * listed(targetList, here + 1).xyz;
  }
  vec4 whole = vec4(point, 1.0);
  place = vec3(dot(a, whole), dot(b, whole), dot(c, whole));
  across = normalize(vec3(dot(cross(b.xyz, c.xyz), upright), dot(cross(c.xyz, a.xyz), upright), dot(cross(a.xyz, b.xyz), upright)) + 1e-20);
}`;

const BODY_VERTEX = /* glsl */ `
varying vec3 vNormal;
varying vec3 vTone;
varying vec3 vToward;
varying vec4 vPaint;
${STAND}
POSE
void main() {
  stand();
  if (tone.a < 0.5 || bare()) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); return; } // drawn in full by another call, or not worn
  vec3 place, across;
  posed(place, across);
  vec3 world = here + turned * (place * bodyLength);
  vNormal = turned * across;
  vTone = tone.rgb;
  vPaint = painted();
  vToward = cameraPosition - world;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(world, 1.0);
}`;

/** The linear colour of a display colour. */
const DECODED = /* glsl */ `
vec3 decoded(vec3 shown) {
  return mix(pow((shown + 0.055) / 1.055, vec3(2.4)), shown / 12.92, vec3(lessThan(shown, vec3(0.04045))));
}`;

const BODY_FRAGMENT = /* glsl */ `
${DECODED}
uniform vec3 sun;
uniform vec3 worldUp;
varying vec3 vNormal;
varying vec3 vTone;
varying vec3 vToward;
varying vec4 vPaint;
void main() {
  vec3 n = normalize(vNormal);
  vec3 toward = normalize(vToward);
  if (dot(n, toward) < 0.0) n = -n;
  vec3 colour = mix(vPaint.rgb, decoded(vTone), vPaint.a);
  float above = 0.5 + 0.5 * dot(n, worldUp);
  float lit = max(dot(n, sun), 0.0);
  vec3 shade = colour * (0.34 + 0.38 * above + 0.52 * lit);
  float gloss = pow(max(dot(reflect(-sun, n), toward), 0.0), 24.0);
  gl_FragColor = vec4(shade + 0.16 * gloss * vPaint.a, 1.0);
  #include <colorspace_fragment>
}`;

const SHADOW_VERTEX = /* glsl */ `
uniform vec2 shade;
varying vec2 vAt;
${STAND}
void main() {
  stand();
  vAt = position.xy;
  vec3 laid = vec3(position.x * shade.x, 0.03, position.y * shade.y) * bodyLength;
  vec4 seen = modelViewMatrix * vec4(here + turned * laid, 1.0);
  seen.xyz *= 1.0 - min(0.3 * bodyLength / length(seen.xyz), 0.2); // nearer, so that uneven ground does not cut it
  gl_Position = projectionMatrix * seen;
}`;

const SHADOW_FRAGMENT = /* glsl */ `
varying vec2 vAt;
void main() {
  float part = 1.0 - smoothstep(0.1, 1.0, length(vAt));
  gl_FragColor = vec4(0.0, 0.0, 0.0, 0.5 * part);
}`;

const RING_VERTEX = /* glsl */ `
varying vec2 vAt;
varying float vWide;
varying vec3 vTone;
${STAND}
void main() {
  stand();
  float depth = max(-(modelViewMatrix * vec4(here, 1.0)).z, 1e-6);
  float radius = max(bodyLength * 0.95, 9.0 * depth / focal);
  vAt = position.xy;
  vWide = clamp(2.2 * depth / focal / radius, 0.05, 0.5);
  vTone = tone.rgb;
  vec3 laid = vec3(position.x, 0.08, position.y) * radius * (1.0 + vWide);
  vAt *= 1.0 + vWide;
  vec4 seen = modelViewMatrix * vec4(here + turned * laid, 1.0);
  seen.xyz *= 1.0 - min(0.2 * radius / length(seen.xyz), 0.2);
  gl_Position = projectionMatrix * seen;
}`;

const RING_FRAGMENT = /* glsl */ `
${DECODED}
uniform float fade;
varying vec2 vAt;
varying float vWide;
varying vec3 vTone;
void main() {
  float off = abs(length(vAt) - 1.0 + 0.5 * vWide);
  float part = 1.0 - smoothstep(0.35 * vWide, 0.75 * vWide, off);
  if (part < 0.02) discard;
  gl_FragColor = vec4(decoded(vTone), part * fade);
  #include <colorspace_fragment>
}`;

/** The uniforms of the shaders of bodies, shadows and rings, besides the rows. */
export type Uniforms = Record<
  | "t"
  | "focal"
  | "least"
  | "sun"
  | "worldUp"
  | "firstRow"
  | "secondRow"
  | "thirdRow"
  | "bones"
  | "perRow"
  | "gazes"
  | "targetList"
  | "palette"
  | "gazeTexels"
  | "traitAt"
  | "targets"
  | "vertices"
  | "shade",
  THREE.IUniform
>;

export function standing(stage: Stage): Uniforms {
  return {
    t: { value: 1 },
    focal: { value: 1 },
    least: { value: 6 },
    sun: { value: stage.sun },
    worldUp: { value: stage.up },
    firstRow: { value: null },
    secondRow: { value: null },
    thirdRow: { value: null },
    bones: { value: 1 },
    perRow: { value: 1 },
    gazes: { value: null },
    targetList: { value: null },
    palette: { value: null },
    gazeTexels: { value: 1 }, // number of vec3 entries per row of `gazes`, and index of the first trait in it
    traitAt: { value: 0 },
    targets: { value: 0 },
    vertices: { value: 1 },
    shade: { value: new THREE.Vector2(0.72, 0.46) }, // half axes of the shadow, in body lengths
  };
}

/** Return the materials. `skinned`: for meshes that follow bones, otherwise for rigid meshes. */
export function bodyMaterial(uniforms: Uniforms, skinned: boolean): THREE.ShaderMaterial {
  const vertexShader = BODY_VERTEX.replace("POSE\n", `${skinned ? SKIN : STILL}\n`);
  return new THREE.ShaderMaterial({ vertexShader, fragmentShader: BODY_FRAGMENT, uniforms, side: THREE.DoubleSide });
}

export function shadowMaterial(uniforms: Uniforms): THREE.ShaderMaterial {
  const blended = { blending: THREE.CustomBlending, blendSrc: THREE.SrcAlphaFactor, blendDst: THREE.OneMinusSrcAlphaFactor };
  const seen = { ...blended, transparent: false, depthWrite: false, side: THREE.DoubleSide }; // drawn before bodies
  return new THREE.ShaderMaterial({ vertexShader: SHADOW_VERTEX, fragmentShader: SHADOW_FRAGMENT, uniforms, ...seen });
}

/** Return the material of rings. They are drawn twice: in full, and faintly `through` what hides them. */
export function ringMaterial(uniforms: Uniforms, through: boolean): THREE.ShaderMaterial {
  const seen = { transparent: true, depthWrite: false, depthTest: !through, side: THREE.DoubleSide };
  const own = { ...uniforms, fade: { value: through ? 0.35 : 1 } };
  return new THREE.ShaderMaterial({ vertexShader: RING_VERTEX, fragmentShader: RING_FRAGMENT, uniforms: own, ...seen });
}

/** Return a square from -1 to 1, to lie flat below a body. */
export function square(): THREE.InstancedBufferGeometry {
  const made = new THREE.InstancedBufferGeometry();
  made.setAttribute("position", new THREE.BufferAttribute(new Float32Array([-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0]), 3));
  made.setIndex([0, 1, 2, 0, 2, 3]);
  return made;
}
