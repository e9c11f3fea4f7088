// `item:KIND:NAME`: items such as food and nests, with labels for their amounts. They shrink as their amounts decrease.

import * as THREE from "three";
import type { Packet, Scene } from "../../protocol";
import { Labels } from "../labels";
import type { Scenery, Sight } from "../sight";

interface Item {
  group: string; // name of its arrays in frames: item/GROUP/…
  index: number;
  name: string;
  object: THREE.Object3D;
}

type Amount = Scene["items"][number]["amounts"][number];

const UP = new THREE.Vector3(0, 1, 0);
const BEFORE = new THREE.Vector3();
const LEAST = 0.25; // minimum share of its width, so that a nearly empty item stays visible

export function items(sight: Sight): Scenery {
  const { stage, herds, store } = sight;
  const labels = new Labels(stage);
  const shown = new Map<string, Item>();

  function away(slot: string): void {
    const old = shown.get(slot);
    if (!old) return;
    stage.scene.remove(old.object);
    if (old.object instanceof THREE.Mesh) {
      old.object.geometry.dispose();
      (old.object.material as THREE.Material).dispose();
    }
    labels.drop(slot);
    shown.delete(slot);
    drawnItems.delete(`${old.group}.${old.name}`);
  }

  function place(): void {
    let moved = false;
    for (const [slot, item] of shown) moved = set(slot, item) || moved;
    if (moved) stage.relight();
  }

  /** Update the position and size of an item. Return whether its appearance changes. */
  function set(slot: string, item: Item): boolean {
    const arrays = herds.packet?.arrays;
    const position = arrays?.get(`item/${item.group}/position`);
    if (!arrays || !position || position.length <= 3 * item.index) return false;
    const size = (arrays.get(`item/${item.group}/size`)?.[item.index] as number | undefined) ?? stage.extent / 100;
    const k = 3 * item.index;
    BEFORE.copy(item.object.position);
    const wide = item.object.scale.x;
    item.object.position.set(position[k] as number, position[k + 1] as number, position[k + 2] as number);
    item.object.quaternion.setFromUnitVectors(UP, stage.up);
    const amounts = store.now.scene?.items.find((each) => each.name === item.group)?.amounts ?? [];
    const [part, words] = left(amounts, item.index, (name) => arrays.get(`item/${item.group}/amount/${name}`)?.[item.index]);
    item.object.scale.setScalar(size * (LEAST + (1 - LEAST) * Math.cbrt(part)));
    drawnItems.set(`${item.group}.${item.name}`, item.object.scale.x);
    labels.set(slot, item.name, words, item.object.position, stage.up, size * 1.6);
    return !BEFORE.equals(item.object.position) || Math.abs(item.object.scale.x / wide - 1) > 0.01;
  }

  herds.onFrame(place);
  store.on("scene", () => {
    const there = new Set(store.now.scene?.items.flatMap((group) => group.names.map((name) => `item:${group.name}:${name}`)));
    for (const slot of [...shown.keys()]) if (!there.has(slot)) away(slot);
    place();
  });

  return {
    slots: ["item"],
    take(packet) {
      away(packet.slot);
      const item = made(packet);
      stage.scene.add(item.object);
      shown.set(packet.slot, item);
      set(packet.slot, item);
      stage.relight();
    },
  };
}

/** Return the remaining share of the initial amount, with a text. Items without an initial amount, such as nests, are whole. */
export function left(amounts: readonly Amount[], index: number, value: (name: string) => number | undefined): [number, string] {
  let part: number | null = null;
  const words: string[] = [];
  for (const { name, unit, first } of amounts) {
    const now = value(name);
    if (now === undefined) continue;
    const most = first[index] ?? 0;
    if (most > 0) part ??= Math.min(Math.max(now / most, 0), 1);
    words.push(`${Number(now.toPrecision(4)).toLocaleString("en")}${unit && ` ${unit}`} ${name}`);
  }
  return [part ?? 1, words.join(" · ")];
}

/** Return the drawn sizes of items in mm, by `NAMES.NAME`. */
export const drawnItems = new Map<string, number>();

function made(packet: Packet): Item {
  const [, kind = "", name = ""] = packet.slot.split(":");
  const face = packet.arrays.get("face");
  const group = String(packet.header.items ?? kind);
  const index = Number(packet.header.index ?? 0);
  if (!face?.length) return { group, index, name, object: new THREE.Object3D() }; // an item without a mesh
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(packet.arrays.get("position") as Float32Array, 3));
  const display = packet.arrays.get("colour") as Float32Array;
  const linear = Float32Array.from(display, (part) => (part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4));
  geometry.setAttribute("color", new THREE.BufferAttribute(linear, 3));
  geometry.setIndex(new THREE.BufferAttribute(Uint32Array.from(face), 1));
  geometry.computeVertexNormals();
  const light = packet.header.look === "light"; // has its own colour in any light
  const mesh = new THREE.Mesh(
    geometry,
    new THREE.MeshStandardMaterial({
      vertexColors: true,
      roughness: Number(packet.header.roughness ?? 0.55),
      color: light ? 0 : 0xffffff,
      emissive: light ? new THREE.Color().fromArray(linear) : 0,
      side: THREE.DoubleSide,
    }),
  );
  mesh.castShadow = mesh.receiveShadow = true;
  mesh.userData.hides = true;
  return { group, index, name, object: mesh };
}
