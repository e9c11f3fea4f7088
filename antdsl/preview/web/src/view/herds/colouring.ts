// Updates the agents' colours, for each frame and after a new choice of colouring. The legend reads the current colouring.

import { NATURAL } from "../../store";
import type { Herd } from "./herd";
import type { Herds } from "./herds";
import { type Range, paint, paintFromBodies, ranged } from "./colours";
import type { Sight } from "../sight";

export class Colouring {
  range: Range | null = null;
  private way = "";
  private readonly listeners: (() => void)[] = [];

  constructor(private readonly sight: Sight) {
    sight.herds.onFrame(() => this.refresh(sight.herds));
    sight.store.on("colour", () => this.refresh(sight.herds));
  }

  onChange(listener: () => void): void {
    this.listeners.push(listener);
  }

  private refresh(herds: Herds): void {
    const { colour } = this.sight.store.now;
    if (colour !== this.way) this.range = null;
    this.way = colour;
    this.range = colour.startsWith("state") ? null : ranged(herds.byName.values(), colour, this.range);
    for (const herd of herds.all) paint(herd, colour, this.range);
    for (const herd of colour === NATURAL ? herds.byName.values() : []) {
      const keys = herd.species.bodies;
      if (keys.length > 1)
        paintFromBodies(
          herd,
          keys.map((key) => herds.byBody.get(key) as Herd),
        );
    }
    this.sight.bodies.recolour();
    for (const listener of this.listeners) listener();
  }
}
