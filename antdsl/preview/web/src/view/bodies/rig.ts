// The posed body of a species: the samples of its clips, and meshes with vertices that follow bones.

import * as THREE from "three";
import type { NumberArray, Packet } from "../../protocol";
import type { Natural } from "../herds/herd";

export const WIDE = 1024; // texels in a row of a texture that holds a list

/** Clips and joints as textures that hold lists of four numbers. `table`: first the parent of each joint. From `clips` on, for
 * each clip: first sample, sample count, mode, transform group, clips that replace it. From `groups` on: weights of joints. */
export interface Rig {
  joints: number;
  texels: number; // of a joint in a sample: translation, rotation, and scale and shear if there are any
  base: THREE.Matrix3; // from the space of the definition to body lengths, ahead +x, up +y
  samples: THREE.DataTexture;
  table: THREE.DataTexture;
  clips: number;
  groups: number;
  machines: string[];
  loops: boolean[];
  idle: [number, number] | null; // the clip below all others, and its duration in seconds
  leans: boolean;
  looks: string[]; // transform groups; their weights of joints start at `lookAt` in the table
  lookAt: number;
  traits: number; // number of traits: first weights of `targets` blend shapes, then sizes of `scales` groups
  targets: number;
  scales: number;
  scaleAt: number; // in the table: how much the size of a group scales each joint and all joints below it
  palette: THREE.DataTexture; // colours of materials that vary
  natural: Natural;
  legs: number;
  legAt: number; // in the table, five texels for each leg: see antdsl/preview/viewing/body_packets.py
  flat: boolean; // whether a leg has a sole that lies flat on the ground
  length: number; // body length, in units of the definition
  bending: { straight: number; folded: number; sunk: number; plane: number; heel: number }; // parameters of antdsl/bodies/agents/leg_ik.py
}

/** A mesh that follows a rig. `list`: for each bone its joint, its part of a leg, and
 * the three rows of its inverse bind matrix. */
export interface Skin {
  rig: Rig;
  bones: number;
  list: THREE.DataTexture;
  targets: THREE.DataTexture; // for each target and vertex, offsets of position and normal
  rest: Float32Array; // positions in the rest pose, in body lengths
  geometry: THREE.BufferGeometry;
  trunk: Float32Array; // positions in the rest pose that belong to no leg
  half: [number, number]; // extent ahead and aside from its centre, in body lengths
}

export interface Rigged {
  low: Skin;
  fine: Skin;
}

/** Return a list of texels as a texture that is read by index. */
export function list(values: ArrayLike<number>): THREE.DataTexture {
  const count = Math.max(Math.ceil(values.length / 4), 1);
  const rows = Math.ceil(count / WIDE);
  const texels = new Float32Array(4 * WIDE * rows);
  texels.set(values);
  const made = new THREE.DataTexture(texels, WIDE, rows, THREE.RGBAFormat, THREE.FloatType);
  made.needsUpdate = true;
  return made;
}

/** Return the rig of a packet `rig:KEY`. */
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
    natural: naturalOf(packet),
    legs: leg.length / 20,
    flat: [...leg].some((each, k) => k % 20 === 7 && each > 0),
    legAt: joints + clip.length / 4 + group.length,
    length: Number(packet.header.length),
    bending: packet.header.bending as Rig["bending"],
  };
  return { low: skinOf(rig, packet, "low"), fine: skinOf(rig, packet, "fine") };
}

function naturalOf(packet: Packet): Natural {
  const [trait = -1, steps = 0] = packet.header.natural as number[];
  return { table: Uint8Array.from(packet.arrays.get("natural") as NumberArray), trait, steps };
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
