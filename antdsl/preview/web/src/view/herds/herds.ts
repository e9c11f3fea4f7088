// All agents: takes frames, keeps the time between two of them, and informs listeners.

import type { NumberArray, Packet, Scene } from "../../protocol";
import type { Store } from "../../store";
import { type Acts, Herd } from "./herd";
import type { Stage } from "../stage";

const LONGEST = 300; // ms; maximum duration of the motion from one frame to the next

export class Herds {
  readonly byName = new Map<string, Herd>();
  readonly byBody = new Map<string, Herd>(); // agents of each body, by body key
  frame = -1;
  light = false;
  t = 1; // progress between the last two frames, 0 to 1
  packet: Packet | null = null;
  private readonly acts = new Map<string, Acts>();
  private arrived = 0;
  private lasts = 40; // recent ms between two frames
  private readonly listeners: (() => void)[] = [];
  private readonly peopled: (() => void)[] = [];

  constructor(
    stage: Stage,
    private readonly store: Store,
  ) {
    store.on("scene", () => this.people(store.now.scene as Scene));
    store.connection.onPacket((packet) => {
      if (packet.slot === "frame") this.take(packet);
    });
    stage.add((now) => this.move(now));
    this.onFrame(() => stage.wake());
  }

  /** Add a listener for each frame. */
  onFrame(listener: () => void): void {
    this.listeners.push(listener);
  }

  /** Add a listener for changes of the set of species. */
  onPeople(listener: () => void): void {
    this.peopled.push(listener);
  }

  get count(): number {
    let sum = 0;
    for (const herd of this.byName.values()) sum += herd.count;
    return sum;
  }

  /** Return all herds: of species, and of bodies where a species has several. */
  get all(): Set<Herd> {
    return new Set([...this.byName.values(), ...this.byBody.values()]);
  }

  /** Set what agents can do with a body. */
  acting(key: string, acts: Acts): void {
    this.acts.set(key, acts);
    this.byBody.get(key)?.acting(acts);
    for (const listener of this.listeners) listener(); // colours and poses depend on it
  }

  private people(scene: Scene): void {
    this.byName.clear();
    this.byBody.clear();
    for (const species of scene.species) {
      const one = species.bodies.length < 2;
      const herd = new Herd(species);
      if (!one) {
        if (this.packet) herd.take(this.packet, 1, true);
        this.byName.set(species.name, herd);
      }
      for (const [body, key] of species.bodies.entries()) {
        const part = one ? herd : new Herd(species, key);
        const acts = this.acts.get(key);
        part.clock = this.frame / scene.fps;
        if (acts) part.acting(acts);
        if (this.packet) part.take(one ? this.packet : partOf(this.packet, species.name, body), 1, true);
        if (one) this.byName.set(species.name, part);
        this.byBody.set(key, part);
      }
    }
    for (const listener of this.peopled) listener();
    for (const listener of this.listeners) listener();
  }

  private take(packet: Packet): void {
    const frame = packet.header.frame ?? 0;
    const now = performance.now();
    const on = frame - this.frame;
    const fps = this.store.now.scene?.fps ?? 24;
    const leap = this.packet === null || on < 0 || on > Math.max(fps, 24) || document.hidden;
    const gap = now - this.arrived;
    if (!leap && on > 0) this.lasts += (Math.min(Math.max(gap, 8), LONGEST) - this.lasts) * 0.25;
    for (const herd of this.byName.values()) {
      herd.clock = frame / fps;
      herd.take(packet, this.t, leap);
      const { bodies, name } = herd.species;
      for (const [body, key] of bodies.length > 1 ? bodies.entries() : []) {
        const part = this.byBody.get(key) as Herd;
        part.clock = frame / fps;
        part.take(partOf(packet, name, body), this.t, leap);
      }
    }
    this.frame = frame;
    this.light = packet.header.light === true;
    this.packet = packet;
    this.arrived = now;
    this.t = leap ? 1 : 0;
    for (const listener of this.listeners) listener();
  }

  private move(now: number): boolean {
    if (this.t >= 1) return false;
    this.t = Math.min(Math.max((now - this.arrived) / this.lasts, this.t), 1);
    return this.t < 1;
  }
}

/** Return a frame of a species with only the agents of one body. */
export function partOf(packet: Packet, species: string, body: number): Packet {
  const arrays: Packet["arrays"] = new Map(packet.arrays);
  const bodies = packet.arrays.get(`${species}/body`);
  const count = packet.arrays.get(`${species}/id`)?.length ?? 0;
  const rows: number[] = [];
  for (let row = 0; row < count; row++) if ((bodies?.[row] ?? 0) === body) rows.push(row);
  for (const [name, values] of packet.arrays) {
    if (!name.startsWith(`${species}/`)) continue;
    const wide = values.length / Math.max(count, 1);
    const some = new (values.constructor as new (size: number) => NumberArray)(rows.length * wide);
    for (const [k, row] of rows.entries()) some.set(values.subarray(row * wide, (row + 1) * wide) as never, k * wide);
    arrays.set(name, some);
  }
  return { ...packet, arrays };
}
