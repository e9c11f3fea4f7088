// `window.antdsl`: read-only numbers about the view, for tests in a browser and for curious users.

import { onScreen } from "../picking";
import { drawnItems } from "../scenery/items";
import type { Sight } from "../sight";
import { tally } from "./legend";

export interface Hook {
  readonly frame: number; // the displayed frame, or the one that the motion leads to
  readonly light: boolean;
  readonly agents: number;
  readonly pictures: number; // number of drawn pictures
  readonly still: boolean; // whether the view shows the frame itself, without motion towards it
  counts(): Record<string, number>; // number of agents by `species.machine.state`
  screen(species: string, id: number): [number, number] | null; // CSS px in the view
  ids(species: string): number[];
  position(species: string, id: number): [number, number, number] | null;
  item(names: string, name: string): number | null; // drawn size in mm
  bones(species: string, id: number): number[][]; // of the last picture: the three rows of the matrix of each bone
  camera(): number[]; // position and target in mm
}

declare global {
  interface Window {
    antdsl?: Hook;
  }
}

export function hook(sight: Sight): void {
  const { herds, stage } = sight;
  window.antdsl = {
    get frame() {
      return herds.frame;
    },
    get light() {
      return herds.light;
    },
    get agents() {
      return herds.count;
    },
    get pictures() {
      return stage.pictures;
    },
    get still() {
      return herds.t >= 1;
    },
    counts() {
      const found: [string, number][] = [];
      for (const [name, herd] of herds.byName) {
        for (const machine of herd.species.machines) {
          for (const [k, count] of tally(herd, machine).entries())
            found.push([`${name}.${machine.name}.${machine.states[k]}`, count]);
        }
      }
      return Object.fromEntries(found);
    },
    screen: (species, id) => onScreen(sight, { species, id }),
    ids: (species) => Array.from(herds.byName.get(species)?.ids ?? []),
    item: (names, name) => drawnItems.get(`${names}.${name}`) ?? null,
    camera: () => [...sight.eye.place.at.toArray(), ...sight.eye.place.target.toArray()],
    bones(species, id) {
      const drawn = sight.bodies.posed(species, herds.byName.get(species)?.row(id) ?? -1);
      return drawn?.figure.poser?.all(drawn.place) ?? [];
    },
    position(species, id) {
      const herd = herds.byName.get(species);
      const row = herd?.row(id) ?? -1;
      if (!herd || row < 0) return null;
      const at = { x: 0, y: 0, z: 0 };
      herd.place(row, herds.t, at);
      return [at.x, at.y, at.z];
    },
  };
}
