// All agents: takes the frames that come, keeps the time between two of them, and tells who wants to know.

import type { Packet, Scene } from "../protocol";
import type { Store } from "../store";
import { type Acts, Herd } from "./herd";
import type { Stage } from "./stage";

const LONGEST = 300; // ms that the way from one frame to the next takes at most

export class Herds {
  readonly byName = new Map<string, Herd>();
  frame = -1;
  light = false;
  t = 1; // how far between the last two frames
  packet: Packet | null = null;
  private readonly acts = new Map<string, Acts>();
  private arrived = 0;
  private lasts = 40; // ms between two frames, as they have come lately
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

  /** After each frame that came. */
  onFrame(listener: () => void): void {
    this.listeners.push(listener);
  }

  /** When the species are other ones. */
  onPeople(listener: () => void): void {
    this.peopled.push(listener);
  }

  get count(): number {
    let sum = 0;
    for (const herd of this.byName.values()) sum += herd.count;
    return sum;
  }

  /** What a species can do with its body. */
  acting(species: string, acts: Acts): void {
    this.acts.set(species, acts);
    this.byName.get(species)?.acting(acts);
  }

  private people(scene: Scene): void {
    this.byName.clear();
    for (const species of scene.species) {
      const herd = new Herd(species);
      const acts = this.acts.get(species.name);
      herd.clock = this.frame / scene.fps;
      if (acts) herd.acting(acts);
      if (this.packet) herd.take(this.packet, 1, true);
      this.byName.set(species.name, herd);
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
