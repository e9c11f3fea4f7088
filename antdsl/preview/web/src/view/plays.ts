// What the agents of one species play, row by row as the shader that poses them reads it: as it was and as it is.

import type { NumberArray } from "../protocol";

export const TEXELS = 4; // of four numbers, of what one machine of an agent plays
export const NONE = 65535; // the number of no clip
const PART = 4 * TEXELS;
const WHOLE = 65535;

// Places in a part: the clip and those before it, then by slot how far through each is, at first and at last, and how much it
// weighs.
const SLOTS = [
  { turn: [4, 5], weight: [10, 11] },
  { turn: [6, 7], weight: [12, 13] },
  { turn: [8, 9], weight: [14, 15] },
] as const;

export class Plays {
  data = new Float32Array(0);
  machines: string[] = [];
  version = 0; // changes with each frame
  private loops: boolean[] = [];
  private was = new Float32Array(0);

  /** Numbers that a row has. */
  get width(): number {
    return PART * this.machines.length;
  }

  /** The machines that play, and of each clip whether it begins again when it is over. What was known is forgotten. */
  begin(machines: string[], loops: boolean[]): void {
    this.machines = machines;
    this.loops = loops;
    this.data = new Float32Array(0);
    this.was = this.data;
    this.version++;
  }

  /** Take a frame: of each machine uint16 [n, 3, 2 or 3], or nothing where the frame does not tell. `from`: the row before of each row, or
   * -1; rows go on from what they show, `t` of the way. */
  take(told: (NumberArray | undefined)[], count: number, from: Int32Array, t: number): void {
    const { width } = this;
    [this.was, this.data] = [this.data, this.was];
    if (this.data.length < count * width) this.data = new Float32Array(Math.ceil(count * 1.3 + 8) * width);
    for (let machine = 0; machine < this.machines.length; machine++) {
      const now = told[machine];
      for (let row = 0; row < count; row++) {
        const k = row * width + PART * machine;
        const other = from[row] as number;
        const before = other >= 0 && (other + 1) * width <= this.was.length ? other * width + PART * machine : -1;
        if (now) this.go(k, now, now.length / count / 3, row, before, t);
        else this.stay(k, before, t);
      }
    }
    this.version++;
  }

  /** A part goes from what it showed to what it is told, `many` clips a row. */
  private go(k: number, told: NumberArray, many: number, row: number, before: number, t: number): void {
    const { data } = this;
    for (let slot = 0; slot < SLOTS.length; slot++) {
      const { turn, weight } = SLOTS[slot] as (typeof SLOTS)[number];
      const at = 3 * many * row + slot;
      const there = slot < many;
      data[k + slot] = there ? (told[at] as number) : NONE;
      const [far, much] = there ? [(told[at + many] as number) / WHOLE, (told[at + 2 * many] as number) / WHOLE] : [0, 0];
      data[k + turn[0]] = far;
      data[k + turn[1]] = far;
      data[k + weight[0]] = much;
      data[k + weight[1]] = much;
    }
    if (before < 0 || !this.known(k, before)) return;
    for (let slot = 0; slot < SLOTS.length; slot++) this.follow(k, slot, before, t);
  }

  /** Whether what was played is played still, if only as what gives way: else it is done at once. */
  private known(k: number, before: number): boolean {
    const last = this.was[before] as number;
    return last === NONE || SLOTS.some((_, slot) => this.data[k + slot] === last);
  }

  private follow(k: number, slot: number, before: number, t: number): void {
    const { data, was } = this;
    const clip = data[k + slot] as number;
    if (clip === NONE) return;
    const { turn, weight } = SLOTS[slot] as (typeof SLOTS)[number];
    const same = [slot, 0, 1, 2].find((each) => was[before + each] === clip);
    data[k + weight[0]] = 0;
    if (same === undefined) return;
    const old = SLOTS[same] as (typeof SLOTS)[number];
    data[k + weight[0]] = mixed(was, before, old.weight, t);
    const here = data[k + turn[1]] as number;
    let way = here - mixed(was, before, old.turn, t);
    if (this.loops[clip]) way -= Math.round(way);
    data[k + turn[0]] = here - (this.loops[clip] ? way : Math.max(way, 0)); // played again it begins at once
  }

  /** A part stays as it is shown. */
  private stay(k: number, before: number, t: number): void {
    const { data, was } = this;
    for (let slot = 0; slot < SLOTS.length; slot++) {
      const { turn, weight } = SLOTS[slot] as (typeof SLOTS)[number];
      data[k + slot] = before < 0 ? NONE : (was[before + slot] as number);
      for (const part of [turn, weight]) {
        const value = before < 0 ? 0 : mixed(was, before, part, t);
        data[k + part[0]] = value;
        data[k + part[1]] = value;
      }
    }
  }
}

function mixed(of: Float32Array, at: number, [a, b]: readonly [number, number], t: number): number {
  const from = of[at + a] as number;
  return from + ((of[at + b] as number) - from) * t;
}
