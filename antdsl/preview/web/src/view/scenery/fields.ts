// `fieldmesh:NAME` and `field:NAME`: fields as colour over the ground. High values are opaque.

import * as THREE from "three";
import { DECADES, LEAST, SHOWN, fullOf } from "../scales";
import type { Scenery, Sight } from "../sight";

const VERTEX = /* glsl */ `
attribute float value;
varying float vValue;
void main() {
  vValue = value;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  gl_Position.z -= 6e-5 * gl_Position.w;
}`;

// One hue up to the middle, then lighter: low values are visible, and high values still differ. The same as `shade` of scales.ts.
const FRAGMENT = /* glsl */ `
uniform vec3 colour;
uniform vec3 strong;
uniform float end;
varying float vValue;
void main() {
  float power = (vValue * 255.0 - 1.0) * ${(DECADES / 254).toFixed(8)} + ${LEAST.toFixed(1)};
  float seen = clamp(1.0 + (power - end) / ${SHOWN.toFixed(1)}, 0.0, 1.0);
  if (vValue < 0.002 || seen <= 0.0) discard;
  gl_FragColor = vec4(mix(colour, strong, smoothstep(0.45, 1.0, seen)), 0.72 * seen);
  #include <colorspace_fragment>
}`;

interface Uniforms {
  colour: { value: THREE.Color };
  strong: { value: THREE.Color };
  end: { value: number };
}
type FieldMesh = THREE.Mesh<THREE.BufferGeometry, THREE.ShaderMaterial> & { material: { uniforms: Uniforms } };

export function fields(sight: Sight): Scenery {
  const { stage, store } = sight;
  const shown = new Map<string, FieldMesh>();

  function refresh(): void {
    for (const [name, mesh] of shown) mesh.visible = store.now.fields.includes(name);
    stage.wake();
  }

  function dress(): void {
    for (const [name, mesh] of shown) {
      const colour = store.now.scene?.fields.find((each) => each.name === name)?.colour ?? [0.9, 0.6, 0.2];
      const { uniforms } = mesh.material;
      uniforms.colour.value.setRGB(...colour, THREE.SRGBColorSpace);
      uniforms.strong.value.setRGB(...colour, THREE.SRGBColorSpace).lerp(stage.palette.ink, 0.55);
      uniforms.end.value = Math.log10(fullOf(store.now, name));
    }
    stage.wake();
  }

  let scene = "";
  stage.palette.onChange(dress);
  store.on("full", dress);
  store.on("fields", refresh);
  store.on("scene", () => {
    const names = new Set(store.now.scene?.fields.map((field) => field.name));
    for (const [name, mesh] of shown) {
      if (names.has(name)) continue;
      stage.scene.remove(mesh);
      mesh.geometry.dispose();
      mesh.material.dispose();
      shown.delete(name);
    }
    dress();
    refresh();
    if (store.now.scene?.name === scene) return;
    scene = store.now.scene?.name ?? "";
    store.set("fields", [...names]); // a field with content is displayed until the user hides it
  });

  function spread(name: string, position: Float32Array, face: Uint32Array): void {
    let mesh = shown.get(name);
    if (!mesh) {
      mesh = made();
      stage.scene.add(mesh);
      shown.set(name, mesh);
    }
    mesh.geometry.dispose();
    mesh.geometry = ground(position, face);
    dress();
    refresh();
  }

  return {
    slots: ["fieldmesh", "field"],
    take(packet) {
      const name = packet.slot.slice(packet.slot.indexOf(":") + 1);
      const position = packet.arrays.get("position");
      if (position) spread(name, position as Float32Array, Uint32Array.from(packet.arrays.get("face") ?? []));
      const values = packet.arrays.get("value");
      const attribute = shown.get(name)?.geometry.getAttribute("value") as THREE.BufferAttribute | undefined;
      if (!values || !attribute || attribute.array.length !== values.length) return;
      (attribute.array as Uint8Array).set(values);
      attribute.needsUpdate = true;
      stage.wake();
    },
  };
}

function made(): FieldMesh {
  const uniforms: Uniforms = { colour: { value: new THREE.Color() }, strong: { value: new THREE.Color() }, end: { value: 0 } };
  const material = new THREE.ShaderMaterial({
    vertexShader: VERTEX,
    fragmentShader: FRAGMENT,
    transparent: true,
    depthWrite: false,
    side: THREE.DoubleSide,
  });
  const mesh = new THREE.Mesh(new THREE.BufferGeometry(), Object.assign(material, { uniforms }));
  mesh.renderOrder = 1;
  return mesh;
}

/** Return the mesh of the ground with a value for each vertex, all 0. */
function ground(position: Float32Array, face: Uint32Array): THREE.BufferGeometry {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(position, 3));
  geometry.setIndex(new THREE.BufferAttribute(face, 1));
  const value = new THREE.BufferAttribute(new Uint8Array(position.length / 3), 1, true);
  return geometry.setAttribute("value", value.setUsage(THREE.DynamicDrawUsage));
}
