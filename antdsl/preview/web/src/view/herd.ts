// The agents of one species as they are shown: where each was and is, row by row, for what draws between the two.

import type { NumberArray, Packet, Species } from "../protocol";
import { Feet } from "./feet";
import { Gaze } from "./gaze";
import { NONE, Plays } from "./plays";

/** What is drawn of an agent: one row in each array. Places and sizes in mm, turns as signed bytes. */
export class Rows {
  placeA = new Float32Array(0);
  placeB = new Float32Array(0);
  headA = new Int8Array(0);
  headB = new Int8Array(0);
  upA = new Int8Array(0);
  upB = new Int8Array(0);
  size = new Float32Array(0);
  wears = new Float32Array(0); // layers beside the body's own, a bit for each
  tone = new Uint8Array(0); // display colour and a fourth
  version = 0; // changes when the arrays are other ones

  get capacity(): number {
    return this.tone.length / 4;
  }

  /** Room for so many; what was there is gone. */
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

  /** Take a row of another herd's. */
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

const GOLDEN = (Math.sqrt(5) - 1) / 2; // multiples of it are spread evenly over a turn

/** What a species can do with its body: the machines that play clips, which clips begin again when they are over, how many legs
 * it stands on. */
export interface Acts {
  machines: string[];
  loops: boolean[];
  legs: number;
  looks: string[]; // the transform groups that it looks with
  leans: boolean; // clips give way to others as it turns and climbs
  traits: number; // numbers that its bodies differ by beside that
  idle: [number, number] | null; // the clip that lies below all others, and the seconds that it takes
}

export class Herd {
  readonly rows = new Rows();
  readonly plays = new Plays();
  readonly feet = new Feet();
  readonly gaze = new Gaze();
  clock = 0; // seconds from frame 0
  private machines: string[] = [];
  private idle: Acts["idle"] = null;
  ids: NumberArray = new Int32Array(0);
  arrays: Packet["arrays"] = new Map();
  count = 0;
  private readonly was = new Rows(); // the rows before, while they are matched
  private from = new Int32Array(0); // the row before of each row, -1 of who is new

  /** All agents of a species, or, with the key of a body, those that have it. */
  constructor(
    readonly species: Species,
    readonly key = species.name,
  ) {}

  column(name: string): NumberArray | undefined {
    return this.arrays.get(`${this.key}/${name}`) ?? this.arrays.get(`${this.species.name}/${name}`);
  }

  /** Take a frame. Rows go on from where they are shown, `t` of the way, unless time leaps. */
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

  /** What it can do with its body is other than before. */
  acting({ machines, loops, legs, looks, leans, traits, idle }: Acts): void {
    this.machines = machines;
    this.idle = idle;
    this.plays.begin(idle ? ["", ...machines] : machines, loops);
    this.feet.begin(legs);
    const threes = Array.from({ length: Math.ceil(traits / 3) }, (_, k) => `trait/${k}`);
    this.gaze.begin([...looks.map((group) => `look/${group}`), ...(leans ? ["lean"] : []), ...threes]);
    this.from.fill(-1);
    this.act(1);
  }

  private act(t: number): void {
    const told = this.machines.map((machine) => this.column(`plays/${machine}`));
    this.plays.take(this.idle ? [this.idling(...this.idle), ...told] : told, this.count, this.from, t);
    this.feet.take(this.column("feet"), this.column("stance"), this.count, this.from, t);
    const looks = this.gaze.groups.map((group) => this.column(group));
    this.gaze.take(looks, this.count, this.from, t);
  }

  /** What agents play where no machine says otherwise: each from a start of its own, by the clock of the frame. */
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
    leapt ||= far > 40 * size; // born anew or thrown: nobody walks so far in a frame
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

  /** The row of an agent, or -1: rows stand by id. */
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

  /** Where a row is shown. */
  place(row: number, t: number, into: { x: number; y: number; z: number }): void {
    const { placeA, placeB } = this.rows;
    const k = 3 * row;
    into.x = mixed(placeA[k] as number, placeB[k] as number, t);
    into.y = mixed(placeA[k + 1] as number, placeB[k + 1] as number, t);
    into.z = mixed(placeA[k + 2] as number, placeB[k + 2] as number, t);
  }

  /** A row's heading or up, about of length 1. */
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
