// What tests are about: small scenes, statuses and frames, each with what a test names and nothing unexpected beside it.

import { Connection } from "../src/connection";
import type { Ask, Machine, Packet, Param, Scene, Species, Status } from "../src/protocol";
import { Store } from "../src/store";
import { type Acts, Herd } from "../src/view/herds/herd";

export const MACHINE: Machine = {
  name: "main",
  states: ["search", "carry"],
  colours: [
    [1, 0, 0],
    [0, 0.5, 1],
  ],
};

export function species(more: Partial<Species> = {}): Species {
  return { name: "ant", bodies: [more.name ?? "ant"], attributes: [], machines: [MACHINE], layers: [], feelers: [], ...more };
}

export function scene(more: Partial<Scene> = {}): Scene {
  return {
    op: "scene",
    name: "test",
    fps: 10,
    last: 100,
    unit_mm: 1,
    up: [0, 1, 0],
    low: [0, 0, 0],
    high: [1, 1, 1],
    camera: null,
    species: [species()],
    params: [],
    fields: [],
    flows: [],
    curves: [],
    solids: [],
    items: [],
    specs: [],
    charts: [],
    charts_need: "",
    ...more,
  };
}

export function status(more: Partial<Status> = {}): Status {
  return {
    op: "status",
    frame: 0,
    first: 0,
    head: 0,
    playing: false,
    speed: 1,
    rate: 0,
    edited: false,
    fault: null,
    paused_by: null,
    paused_agents: null,
    hash: null,
    agents: 0,
    transitions: {},
    light: false,
    ...more,
  };
}

export function param(more: Partial<Param> = {}): Param {
  return {
    name: "ant.smell",
    value: "50 mm",
    number: 50,
    unit: "mm",
    low: null,
    high: null,
    help: "",
    file: "ants.ant",
    line: 1,
    written: "50 mm",
    ...more,
  };
}

type Listener = (message: unknown) => void;

/** A connection without a server: it stores what the page sends in `sent`; `receive` passes a message to the page. */
export class Wire extends Connection {
  readonly sent: Ask[] = [];
  private readonly listening = new Map<string, Listener[]>();

  constructor() {
    super("", "");
  }

  override on(op: string, listener: (message: never) => void): void {
    this.listening.set(op, [...(this.listening.get(op) ?? []), listener as Listener]);
  }

  override ask(message: Ask): void {
    this.sent.push(message);
  }

  receive(message: { op: string }): void {
    for (const listener of this.listening.get(message.op) ?? []) listener(message);
  }
}

export function wired(): { store: Store; wire: Wire } {
  const wire = new Wire();
  return { store: new Store(wire), wire };
}

/** A frame of ants, all sized 1, by id; with states of `main` where some are given. */
export function frame(
  ids: number[],
  places: number[],
  more: Record<string, Packet["arrays"] extends Map<string, infer A> ? A : never> = {},
): Packet {
  const arrays: Packet["arrays"] = new Map();
  arrays.set("ant/id", Int32Array.from(ids));
  arrays.set("ant/position", Float32Array.from(places));
  arrays.set("ant/size", new Float32Array(ids.length).fill(1));
  for (const [name, array] of Object.entries(more)) arrays.set(`ant/${name}`, array);
  return { slot: "frame", header: { slot: "frame" }, arrays };
}

/** What a body without clips can do; all have the natural colour (90, 60, 30). */
export function acts(more: Partial<Acts> = {}): Acts {
  const natural = { table: Uint8Array.of(90, 60, 30), trait: -1, steps: 0 };
  return { machines: [], loops: [], legs: 0, flat: false, looks: [], leans: false, traits: 0, idle: null, natural, ...more };
}

export function herd(packet: Packet, of: Species = species()): Herd {
  const made = new Herd(of);
  made.take(packet, 1, true);
  return made;
}
