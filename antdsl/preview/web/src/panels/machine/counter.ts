// Counts of agents in each state, from the packet of the displayed frame.

import type { Packet } from "../../protocol";
import type { Agent, Store } from "../../store";

export class Counter {
  changed = false;
  private frame: Packet | null = null;

  constructor(private readonly store: Store) {
    store.connection.onPacket((packet) => {
      if (packet.slot !== "frame") return;
      this.frame = packet;
      this.changed = true;
    });
  }

  /** Return the number of agents in each state, by name of the state. */
  states(species: string, machine: string): Map<string, number> {
    const names = this.names(species, machine);
    const counts = new Array<number>(names.length).fill(0);
    for (const state of this.row(species, machine)) counts[state] = (counts[state] ?? 0) + 1;
    return new Map(names.map((name, k) => [name, counts[k] ?? 0]));
  }

  agents(species: string, machine: string, state: string): Agent[] {
    const index = this.names(species, machine).indexOf(state);
    const ids = this.frame?.arrays.get(`${species}/id`) ?? [];
    const found: Agent[] = [];
    for (const [k, each] of this.row(species, machine).entries())
      if (each === index) found.push({ species, id: ids[k] as number });
    return found;
  }

  stateOf(species: string, machine: string, id: number): string | null {
    const at = Array.from(this.frame?.arrays.get(`${species}/id`) ?? []).indexOf(id);
    return at < 0 ? null : (this.names(species, machine)[this.row(species, machine)[at] ?? -1] ?? null);
  }

  private names(species: string, machine: string): string[] {
    return (
      this.store.now.scene?.species.find((each) => each.name === species)?.machines.find((each) => each.name === machine)
        ?.states ?? []
    );
  }

  private row(species: string, machine: string): Uint8Array {
    return (this.frame?.arrays.get(`${species}/state/${machine}`) as Uint8Array | undefined) ?? new Uint8Array(0);
  }
}
