// The body of a species as it is posed: the clips that are played, sample by sample, and meshes whose vertices follow bones.

import * as THREE from "three";
import type { NumberArray, Packet } from "../protocol";

export const WIDE = 1024; // texels in a row of a texture that holds a list

/** Clips and joints, as textures that hold lists of four numbers. `table`: first the parent of each joint; from `clips` on each
 * clip's first sample, how many, how it plays and its transform group, with those that it gives way to; from `groups` on the weights of joints. */
export interface Rig {
  joints: number;
  texels: number; // of a joint in a sample: translation, rotation, scale and shear where there are any
  base: THREE.Matrix3; // from the definition's space to body lengths, ahead +x, up +y
  samples: THREE.DataTexture;
  table: THREE.DataTexture;
  clips: number;
  groups: number;
  machines: string[];
  loops: boolean[];
  idle: [number, number] | null; // the clip that lies below all others, and the seconds that it takes
  leans: boolean;
  looks: string[]; // transform groups; from `lookAt` on in the table: the weights of joints
  lookAt: number;
  traits: number; // numbers that bodies differ by: first weights of `targets` of blend shapes, then sizes of `scales` groups
  targets: number;
  scales: number;
  scaleAt: number; // in the table: by how much of a group's size each joint and all below it is scaled
  palette: THREE.DataTexture; // colours of materials that vary
  legs: number;
  legAt: number; // in the table: of each leg hip, knee and foot as joints, and the axis of a straight knee
  length: number; // of the body, in the definition's units
  bending: { straight: number; folded: number; sunk: number; plane: number }; // as antdsl/bodies/agents/leg_ik.py has them
}

/** A mesh that follows a rig. `list`: of each bone its joint, the part of a leg that it is, and
 * the three rows of what takes a point of rest to it. */
export interface Skin {
  rig: Rig;
  bones: number;
  list: THREE.DataTexture;
  targets: THREE.DataTexture; // of each target and vertex what is added to place and normal
  rest: Float32Array; // places in the rest pose, in body lengths
  geometry: THREE.BufferGeometry;
  trunk: Float32Array; // those of the rest pose that are no part of a leg
  half: [number, number]; // how far it reaches ahead and aside of its middle, in body lengths
}

export interface Rigged {
  low: Skin;
  fine: Skin;
}

/** A list of texels as a texture that is read by number. */
export function list(values: ArrayLike<number>): THREE.DataTexture {
  const count = Math.max(Math.ceil(values.length / 4), 1);
  const rows = Math.ceil(count / WIDE);
  const texels = new Float32Array(4 * WIDE * rows);
  texels.set(values);
  const made = new THREE.DataTexture(texels, WIDE, rows, THREE.RGBAFormat, THREE.FloatType);
  made.needsUpdate = true;
  return made;
}

/** Of a packet `rig:KEY`. */
export function rigOf(packet: Packet): Rigged {
  const parent = packet.arrays.get("parent") as NumberArray;
  const clip = packet.arrays.get("clip") as NumberArray;
  const group = packet.arrays.get("group") as NumberArray;
  const leg = packet.arrays.get("leg") ?? new Float32Array(0);
  const looks = [...(packet.arrays.get("look") as NumberArray)].flatMap((each) => [each, 0, 0, 0]);
  const scales = [...(packet.arrays.get("scale") ?? [])].flatMap((each) => [each, 0, 0, 0]);
  const joints = parent.length;
  const table = [...parent].flatMap((each) => [each, 0, 0, 0]);
  table.push(...clip);
  const weights = [...group].flatMap((each) => [each, 0, 0, 0]);
  const base = packet.header.base as number[];
  const rig: Rig = {
    joints,
    texels: Number(packet.header.texels),
    base: new THREE.Matrix3().fromArray(base.filter((_, k) => k % 4 < 3)).transpose(),
    samples: list(packet.arrays.get("sample") as NumberArray),
    table: list([...table, ...weights, ...leg, ...looks, ...scales]),
    clips: joints,
    groups: joints + clip.length / 4,
    machines: packet.header.machines as string[],
    loops: [...clip].filter((_, k) => k % 12 === 2).map((each) => each % 2 === 1),
    idle: (packet.header.idle as number[]).length ? (packet.header.idle as [number, number]) : null,
    leans: packet.header.leans === true,
    looks: packet.header.looks as string[],
    lookAt: joints + clip.length / 4 + group.length + leg.length / 4,
    traits: Number(packet.header.traits ?? 0),
    targets: Number(packet.header.targets ?? 0),
    scales: scales.length / 4 / joints,
    scaleAt: joints + clip.length / 4 + group.length + leg.length / 4 + looks.length / 4,
    palette: list(packet.arrays.get("palette") ?? []),
    legs: leg.length / 8,
    legAt: joints + clip.length / 4 + group.length,
    length: Number(packet.header.length),
    bending: packet.header.bending as Rig["bending"],
  };
  return { low: skinOf(rig, packet, "low"), fine: skinOf(rig, packet, "fine") };
}

function skinOf(rig: Rig, packet: Packet, level: string): Skin {
  const take = (name: string) => packet.arrays.get(`${level}/${name}`) as NumberArray;
  const joint = take("joint");
  const part = take("part");
  const inverse = take("inverse");
  const bones: number[] = [];
  for (const [k, each] of joint.entries()) bones.push(each, part[k] as number, 0, 0, ...inverse.subarray(12 * k, 12 * k + 12));
  const geometry = new THREE.BufferGeometry();
  const put = (name: string, parts: number, normalised: boolean) =>
    geometry.setAttribute(name, new THREE.BufferAttribute(take(name).slice(), parts, normalised));
  put("position", 3, false);
  put("normal", 3, true);
  put("colour", 4, true);
  put("bone", 4, false);
  put("weight", 4, false);
  const paint = take("paint");
  const worn = [...take("layer")].flatMap((layer, k) => [layer, paint[2 * k] as number, paint[2 * k + 1] as number]);
  geometry.setAttribute("worn", new THREE.BufferAttribute(Float32Array.from(worn), 3));
  geometry.setIndex(new THREE.BufferAttribute(Uint32Array.from(take("face")), 1));
  const rest = Float32Array.from(take("position"));
  const point = new THREE.Vector3();
  const box = new THREE.Box3();
  for (let k = 0; k < rest.length; k += 3) {
    point.fromArray(rest, k).applyMatrix3(rig.base).toArray(rest, k);
    box.expandByPoint(point);
  }
  const targets: number[] = [];
  const offset = take("target");
  for (let k = 0; k < offset.length; k += 6) targets.push(...offset.subarray(k, k + 3), 0, ...offset.subarray(k + 3, k + 6), 0);
  const bone = take("bone");
  const trunk = rest.filter((_, k) => part[bone[4 * Math.floor(k / 3)] as number] === 0);
  const size = box.isEmpty() ? new THREE.Vector3(1, 1, 1) : box.getSize(point);
  return {
    rig,
    bones: joint.length,
    list: list(bones),
    targets: list(targets),
    rest,
    trunk,
    geometry,
    half: [size.x / 2, size.z / 2],
  };
}

export function forgetRig({ low, fine }: Rigged): void {
  for (const skin of [low, fine]) {
    skin.list.dispose();
    skin.targets.dispose();
    skin.geometry.dispose();
  }
  low.rig.samples.dispose();
  low.rig.table.dispose();
  low.rig.palette.dispose();
}
