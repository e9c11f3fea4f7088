// The state that all parts of the page share, such as the selection. Parts read it, set it and listen for changes.

import type { Connection } from "./connection";
import type { Place, Verbs } from "./directing";
import type { Curves, Explained, Problems, Profile, Scene, Status, Texts } from "./protocol";

export interface Agent {
  species: string;
  id: number;
}

export const NATURAL = "natural colours"; // no attribute can have this name

export interface Shared {
  scene: Scene | null;
  status: Status | null;
  texts: Texts | null;
  problems: Problems | null;
  curves: Curves | null;
  selected: Agent[]; // the last one is explained, all are marked
  explained: Explained | null;
  profile: Profile | null; // null while nothing is measured
  camera: "orbit" | "follow" | "ride";
  colour: string; // NATURAL, `state`, `state/MACHINE`, `speed`, or the name of an attribute
  fields: string[]; // fields displayed on the ground
  full: Record<string, number>; // by field: the value of full colour, where the user chose one
  flows: string[];
  trails: boolean;
  paths: boolean; // planned paths
  feelers: boolean;
  neighbours: boolean;
  curvesShown: boolean;
  glass: boolean; // whether solids, stones and walkable meshes are transparent
  verbs: Verbs | null;
  picking: { agents: boolean; items: boolean; pick: (place: Place) => void } | null; // a click in the view gives a place
  goto: { file: string; line: number; mistake?: boolean } | null; // a line of the text to display
}

type Key = keyof Shared;

export class Store {
  readonly now: Shared = {
    scene: null,
    status: null,
    texts: null,
    problems: null,
    curves: null,
    selected: [],
    explained: null,
    profile: null,
    camera: "orbit",
    colour: NATURAL,
    fields: [],
    full: {},
    flows: [],
    trails: false,
    paths: false,
    feelers: true,
    neighbours: true,
    curvesShown: true,
    glass: false,
    verbs: null,
    picking: null,
    goto: null,
  };
  private readonly listeners = new Map<Key, (() => void)[]>();

  constructor(readonly connection: Connection) {
    connection.on("scene", (scene) => this.set("scene", scene));
    connection.on("verbs", (verbs) => this.set("verbs", verbs));
    connection.on("status", (status) => this.set("status", status));
    connection.on("texts", (texts) => this.set("texts", texts));
    connection.on("problems", (problems) => this.set("problems", problems));
    connection.on("explained", (explained) => this.set("explained", explained));
  }

  set<K extends Key>(key: K, value: Shared[K]): void {
    this.now[key] = value;
    for (const listener of this.listeners.get(key) ?? []) listener();
  }

  on(keys: Key | Key[], listener: () => void): void {
    for (const key of Array.isArray(keys) ? keys : [keys]) {
      this.listeners.set(key, [...(this.listeners.get(key) ?? []), listener]);
    }
  }
}
