// What the parts of the page share: what is selected and looked at. Each part reads it, sets it, and hears of changes.

import type { Connection } from "./connection";
import type { Curves, Explained, Problems, Profile, Scene, Status, Texts } from "./protocol";

export interface Agent {
  species: string;
  id: number;
}

export interface Shared {
  scene: Scene | null;
  status: Status | null;
  texts: Texts | null;
  problems: Problems | null;
  curves: Curves | null;
  selected: Agent[]; // one of them explains itself, more are marked
  explained: Explained | null;
  profile: Profile | null; // none while nothing is measured
  camera: "orbit" | "follow" | "ride";
  colour: string; // `state`, `state/MACHINE`, `speed`, or an attribute's name
  fields: string[]; // shown on the ground
  full: Record<string, number>; // where the colours of a field end, of those for which somebody chose it
  flows: string[];
  trails: boolean;
  paths: boolean; // planned ones
  feelers: boolean;
  neighbours: boolean;
  curvesShown: boolean;
  glass: boolean; // what hides ants is seen through: solids, stones, things to walk on
  goto: { file: string; line: number; mistake?: boolean } | null; // a place in the text to be shown
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
    colour: "state",
    fields: [],
    full: {},
    flows: [],
    trails: false,
    paths: false,
    feelers: true,
    neighbours: true,
    curvesShown: true,
    glass: false,
    goto: null,
  };
  private readonly listeners = new Map<Key, (() => void)[]>();

  constructor(readonly connection: Connection) {
    connection.on("scene", (scene) => this.set("scene", scene));
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
