// The clips that the agents of one species play, row by row for the pose shader: previous and current values.

import type { NumberArray } from "../../protocol";

export const TEXELS = 4; // texels of four numbers for one machine of an agent
export const NONE = 65535; // the number for no clip
const PART = 4 * TEXELS;
const WHOLE = 65535;

// Offsets in a part: three clip numbers (the clip and those before it), then for each slot previous and current progress, and
// previous and current weight.
const SLOTS = [
  { turn: [4, 5], weight: [10, 11] },
  { turn: [6, 7], weight: [12, 13] },
  { turn: [8, 9], weight: [14, 15] },
] as const;

export class Plays {
  data = new Float32Array(0);
  machines: string[] = [];
  version = 0; // increases with each frame
  private loops: boolean[] = [];
  private was = new Float32Array(0);

  /** Numbers per row. */
  get width(): number {
    return PART * this.machines.length;
  }

  /** Set the machines that play clips, and for each clip whether it loops. Earlier values are lost. */
  begin(machines: string[], loops: boolean[]): void {
    this.machines = machines;
    this.loops = loops;
    this.data = new Float32Array(0);
    this.was = this.data;
    this.version++;
  }

  /** Take a frame: for each machine uint16 [n, 3, 2 or 3], or undefined for no data. `from`: the previous row of each row, or
   * -1. Rows continue from the displayed values, `t` of the way between frames. */
  take(values: (NumberArray | undefined)[], count: number, from: Int32Array, t: number): void {
    const { width } = this;
    [this.was, this.data] = [this.data, this.was];
    if (this.data.length < count * width) this.data = new Float32Array(Math.ceil(count * 1.3 + 8) * width);
    for (let machine = 0; machine < this.machines.length; machine++) {
      const now = values[machine];
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

  /** Move a part from the displayed values to the new ones, with `many` clips per row. */
  private go(k: number, values: NumberArray, many: number, row: number, before: number, t: number): void {
    const { data } = this;
    for (let slot = 0; slot < SLOTS.length; slot++) {
      const { turn, weight } = SLOTS[slot] as (typeof SLOTS)[number];
      const at = 3 * many * row + slot;
      const there = slot < many;
      data[k + slot] = there ? (values[at] as number) : NONE;
      const [far, much] = there ? [(values[at + many] as number) / WHOLE, (values[at + 2 * many] as number) / WHOLE] : [0, 0];
      data[k + turn[0]] = far;
      data[k + turn[1]] = far;
      data[k + weight[0]] = much;
      data[k + weight[1]] = much;
    }
    if (before < 0 || !this.known(k, before)) return;
    for (let slot = 0; slot < SLOTS.length; slot++) this.follow(k, slot, before, t);
  }

  /** Return whether the previous clip still plays, perhaps while it fades out. Otherwise the change is immediate. */
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
    data[k + turn[0]] = here - (this.loops[clip] ? way : Math.max(way, 0)); // a repeated clip starts at once
  }

  /** Keep the displayed values of a part. */
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
