// The agents of one species: previous and current positions, row by row, for interpolation between frames.

import type { NumberArray, Packet, Species } from "../../protocol";
import { Feet } from "./feet";
import { Gaze } from "./gaze";
import { Offsets } from "./offsets";
import { NONE, Plays } from "./plays";

/** The drawn values of agents, one row in each array. Positions and sizes in mm, directions as signed bytes. */
export class Rows {
  placeA = new Float32Array(0);
  placeB = new Float32Array(0);
  headA = new Int8Array(0);
  headB = new Int8Array(0);
  upA = new Int8Array(0);
  upB = new Int8Array(0);
  size = new Float32Array(0);
  wears = new Float32Array(0); // layers beside the body's own, one bit each
  tone = new Uint8Array(0); // display colour and a fourth value
  version = 0; // increases when the arrays are replaced

  get capacity(): number {
    return this.tone.length / 4;
  }

  /** Make room for `count` rows. Earlier values are lost. */
  reserve(count: number): void {
    if (count <= this.capacity) return;
    const room = Math.ceil(count * 1.3) + 8;
    for (const name of ["placeA", "placeB"] as const) this[name] = new Float32Array(room * 3);
    this.size = new Float32Array(room);
    this.wears = new Float32Array(room);
    for (const name of ["headA", "headB", "upA", "upB"] as const) this[name] = new Int8Array(room * 4);
    this.tone = new Uint8Array(room * 4);
    this.version++;
  }

  /** Copy a row of another herd. */
  copy(row: number, from: Rows, other: number): void {
    for (let axis = 0; axis < 3; axis++) {
      for (const name of ["placeA", "placeB"] as const) this[name][3 * row + axis] = from[name][3 * other + axis] as number;
      for (const name of ["headA", "headB", "upA", "upB"] as const)
        this[name][4 * row + axis] = from[name][4 * other + axis] as number;
    }
    this.size[row] = from.size[other] as number;
    this.wears[row] = from.wears[other] as number;
  }
}

const GOLDEN = (Math.sqrt(5) - 1) / 2; // its multiples are evenly distributed over a cycle

/** What a body of a species can do: the machines that play clips, which clips loop, its number of legs, and whether their soles
 * lie flat on the ground. */
export interface Acts {
  machines: string[];
  loops: boolean[];
  legs: number;
  flat: boolean;
  looks: string[]; // transform groups for looking
  leans: boolean; // whether other clips replace a clip as the agent turns and climbs
  traits: number; // number of other values by which bodies differ
  idle: [number, number] | null; // the clip below all others, and its duration in seconds
  natural: Natural;
}

/** The natural colours of a body: display bytes, three for each colour. `trait` selects one, at `steps` per unit; -1 without. */
export interface Natural {
  table: Uint8Array;
  trait: number;
  steps: number;
}

export class Herd {
  readonly rows = new Rows();
  readonly plays = new Plays();
  readonly feet = new Feet();
  readonly gaze = new Gaze();
  readonly offsets = new Offsets();
  clock = 0; // seconds since frame 0
  private machines: string[] = [];
  private idle: Acts["idle"] = null;
  natural: Natural | null = null; // null before the body is known
  ids: NumberArray = new Int32Array(0);
  arrays: Packet["arrays"] = new Map();
  count = 0;
  private readonly was = new Rows(); // the previous rows, during matching
  private from = new Int32Array(0); // the previous row of each row, -1 for new agents

  /** All agents of a species; with a body key, only the agents with that body. */
  constructor(
    readonly species: Species,
    readonly key = species.name,
  ) {}

  column(name: string): NumberArray | undefined {
    return this.arrays.get(`${this.key}/${name}`) ?? this.arrays.get(`${this.species.name}/${name}`);
  }

  /** Take a frame. Rows continue from the displayed values, `t` of the way between frames, unless time jumps. */
  take(packet: Packet, t: number, leap: boolean): void {
    const name = this.species.name;
    const ids = packet.arrays.get(`${name}/id`) ?? new Int32Array(0);
    const count = ids.length;
    const old = this.ids;
    const known = leap ? 0 : this.count;
    const { rows, was } = this;
    if (known > 0) {
      was.reserve(known);
      for (const key of ["placeA", "placeB"] as const) was[key].set(rows[key].subarray(0, 3 * known));
      for (const key of ["headA", "headB", "upA", "upB"] as const) was[key].set(rows[key].subarray(0, 4 * known));
      was.wears.set(rows.wears.subarray(0, known));
    }
    rows.reserve(count);
    if (this.from.length < count) this.from = new Int32Array(rows.capacity);
    this.arrays = packet.arrays;
    this.ids = ids;
    this.count = count;
    const place = this.column("position") as NumberArray;
    const head = this.column("heading");
    const up = this.column("up");
    const size = this.column("size");
    const wears = this.column("wears");
    for (let row = 0, other = 0; row < count; row++) {
      const id = ids[row] as number;
      while (other < known && (old[other] as number) < id) other++;
      const before = other < known && old[other] === id ? other : -1;
      this.from[row] = before;
      rows.wears[row] = wears ? (wears[row] as number) : before < 0 ? 0 : (was.wears[before] as number);
      this.stand(row, before, t, place, head, up, size ? (size[row] as number) : 1);
    }
    this.act(t);
  }

  /** Set what the body can do. */
  acting({ machines, loops, legs, flat, looks, leans, traits, idle, natural }: Acts): void {
    this.machines = machines;
    this.idle = idle;
    this.natural = natural;
    this.plays.begin(idle ? ["", ...machines] : machines, loops);
    this.feet.begin(legs, flat);
    const threes = Array.from({ length: Math.ceil(traits / 3) }, (_, k) => `trait/${k}`);
    this.gaze.begin([...looks.map((group) => `look/${group}`), ...(leans ? ["lean"] : []), ...threes]);
    this.from.fill(-1);
    this.act(1);
  }

  private act(t: number): void {
    const values = this.machines.map((machine) => this.column(`plays/${machine}`));
    this.plays.take(this.idle ? [this.idling(...this.idle), ...values] : values, this.count, this.from, t);
    this.feet.take(
      ["feet", "stance", "sole"].map((name) => this.column(name)),
      this.count,
      this.from,
      t,
    );
    const looks = this.gaze.groups.map((group) => this.column(group));
    this.gaze.take(looks, this.count, this.from, t);
    this.offsets.take(this.arrays, this.key, this.count, this.from, t);
  }

  /** Return the clips of agents without clips from machines. Each agent has its own offset to the time of the frame. */
  private idling(clip: number, seconds: number): Uint16Array {
    const made = new Uint16Array(6 * this.count);
    for (let row = 0; row < this.count; row++) {
      const turns = (this.ids[row] as number) * GOLDEN + this.clock / seconds;
      made.set([clip, NONE, Math.round((turns - Math.floor(turns)) * 65535), 0, 65535, 0], 6 * row);
    }
    return made;
  }

  private stand(
    row: number,
    before: number,
    t: number,
    place: NumberArray,
    head: NumberArray | undefined,
    up: NumberArray | undefined,
    size: number,
  ): void {
    const { rows, was } = this;
    let far = 0;
    let leapt = before < 0;
    for (let axis = 0; axis < 3 && !leapt; axis++) {
      const a = was.placeA[3 * before + axis] as number;
      const b = was.placeB[3 * before + axis] as number;
      far += ((place[3 * row + axis] as number) - b) ** 2;
      rows.placeA[3 * row + axis] = a + (b - a) * t;
    }
    far = Math.sqrt(far);
    leapt ||= far > 40 * size; // born again or thrown: nobody walks so far in a frame
    for (let axis = 0; axis < 3; axis++) {
      const k = 4 * row + axis;
      const o = 4 * before + axis;
      const here = place[3 * row + axis] as number;
      rows.placeB[3 * row + axis] = here;
      rows.headB[k] = head ? (head[3 * row + axis] as number) : axis === 0 ? 127 : 0;
      rows.upB[k] = up ? (up[3 * row + axis] as number) : axis === 1 ? 127 : 0;
      if (leapt) rows.placeA[3 * row + axis] = here;
      rows.headA[k] = leapt ? (rows.headB[k] as number) : mixed(was.headA[o] as number, was.headB[o] as number, t);
      rows.upA[k] = leapt ? (rows.upB[k] as number) : mixed(was.upA[o] as number, was.upB[o] as number, t);
    }
    rows.size[row] = size;
  }

  /** Return the row of an agent, or -1. Rows are sorted by id. */
  row(id: number): number {
    let low = 0;
    let high = this.count - 1;
    while (low <= high) {
      const middle = (low + high) >> 1;
      const found = this.ids[middle] as number;
      if (found === id) return middle;
      if (found < id) low = middle + 1;
      else high = middle - 1;
    }
    return -1;
  }

  /** Return the displayed position of a row. */
  place(row: number, t: number, into: { x: number; y: number; z: number }): void {
    const { placeA, placeB } = this.rows;
    const k = 3 * row;
    into.x = mixed(placeA[k] as number, placeB[k] as number, t);
    into.y = mixed(placeA[k + 1] as number, placeB[k + 1] as number, t);
    into.z = mixed(placeA[k + 2] as number, placeB[k + 2] as number, t);
  }

  /** Return heading or up direction of a row, of length about 1. */
  turn(which: "head" | "up", row: number, t: number, into: { x: number; y: number; z: number }): void {
    const a = which === "head" ? this.rows.headA : this.rows.upA;
    const b = which === "head" ? this.rows.headB : this.rows.upB;
    const k = 4 * row;
    into.x = mixed(a[k] as number, b[k] as number, t) / 127;
    into.y = mixed(a[k + 1] as number, b[k + 1] as number, t) / 127;
    into.z = mixed(a[k + 2] as number, b[k + 2] as number, t) / 127;
  }

  size(row: number): number {
    return this.rows.size[row] as number;
  }
}

function mixed(a: number, b: number, t: number): number {
  return a + (b - a) * t;
}
