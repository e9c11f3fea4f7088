// The offsets that edits add to joints of agents' bodies, row by row for the shaders: previous and current values.

import type { NumberArray, Packet } from "../../protocol";

const STORED = 7; // numbers of a joint in a packet: a shift in body lengths, and a rotation x y z w
const PART = 8; // the same in a row, with the number of the joint after the shift
const NEUTRAL = [0, 0, 0, 0, 0, 0, 1];

export class Offsets {
  data = new Float32Array(0);
  joints: number[] = []; // in the order by depth
  version = 0; // increases with each frame that has or had offsets
  private was = new Float32Array(0);
  private wasJoints: number[] = [];

  /** Numbers per row. */
  get width(): number {
    return 2 * PART * this.joints.length;
  }

  /** Take a frame with arrays `KEY/offset/JOINT`. `from`: the previous row of each row, or -1. Rows continue from the displayed
   * values, `t` of the way between frames. */
  take(arrays: Packet["arrays"], key: string, count: number, from: Int32Array, t: number): void {
    const prefix = `${key}/offset/`;
    const values = new Map<number, NumberArray>();
    for (const [name, array] of arrays) if (name.startsWith(prefix)) values.set(Number(name.slice(prefix.length)), array);
    if (!values.size && !this.joints.length) return;
    [this.was, this.data] = [this.data, this.was];
    this.wasJoints = this.joints;
    this.joints = [...values.keys()].sort((a, b) => a - b);
    this.version++;
    if (this.data.length < count * this.width) this.data = new Float32Array(Math.ceil(count * 1.3 + 8) * this.width);
    for (const [place, joint] of this.joints.entries()) {
      const before = this.wasJoints.indexOf(joint);
      const now = values.get(joint) as NumberArray;
      for (let row = 0; row < count; row++)
        this.fill(row * this.width + 2 * PART * place, joint, now, row, from[row] as number, before, t);
    }
  }

  private fill(k: number, joint: number, now: NumberArray, row: number, old: number, before: number, t: number): void {
    const other = (old * this.wasJoints.length + before) * 2 * PART;
    const known = old >= 0 && before >= 0 && other + 2 * PART <= this.was.length;
    for (let number = 0; number < STORED; number++) {
      const here = now[STORED * row + number] as number;
      const place = number < 3 ? number : number + 1;
      const a = known ? (this.was[other + place] as number) : (NEUTRAL[number] as number);
      const b = known ? (this.was[other + PART + place] as number) : a;
      this.data[k + place] = old < 0 ? here : a + (b - a) * t;
      this.data[k + PART + place] = here;
    }
    this.data[k + 3] = joint;
    this.data[k + PART + 3] = joint;
  }
}
