// Where the agents of one species look with parts of their bodies, how they lean and what their bodies differ by, row by row as the
// shaders read it: as it was and as it is.

import type { NumberArray } from "../protocol";

const PART = 8; // numbers that a group has: a direction as it was, and as it is, each in four
const WHOLE = 127;

export class Gaze {
  data = new Float32Array(0);
  groups: string[] = [];
  version = 0; // changes with each frame
  private was = new Float32Array(0);

  /** Numbers that a row has. */
  get width(): number {
    return PART * this.groups.length;
  }

  begin(groups: string[]): void {
    this.groups = groups;
    this.data = new Float32Array(0);
    this.was = this.data;
    this.version++;
  }

  /** Take a frame: of each group int8 [n, 3] (127 is 1) or, of traits, float32 [n, 3]; or nothing where it does not tell, and they stay. `from`: the row before of each row,
   * or -1; rows go on from what they show, `t` of the way. */
  take(told: (NumberArray | undefined)[], count: number, from: Int32Array, t: number): void {
    const { width } = this;
    if (width === 0) return;
    [this.was, this.data] = [this.data, this.was];
    if (this.data.length < count * width) this.data = new Float32Array(Math.ceil(count * 1.3 + 8) * width);
    const { data, was } = this;
    for (let row = 0; row < count; row++) {
      for (let group = 0; group < this.groups.length; group++) {
        const k = row * width + PART * group;
        const other = (from[row] as number) * width + PART * group;
        const known = (from[row] as number) >= 0 && other + PART <= was.length;
        const now = told[group];
        for (let axis = 0; axis < 3; axis++) {
          const straight = axis === 0 && (this.groups[group] as string).startsWith("look") ? 1 : 0;
          const here = now ? (now[3 * row + axis] as number) / (now instanceof Int8Array ? WHOLE : 1) : null;
          const a = was[other + axis] as number;
          const shown = known ? a + ((was[other + 4 + axis] as number) - a) * t : (here ?? straight);
          data[k + axis] = shown;
          data[k + 4 + axis] = here ?? shown;
        }
      }
    }
    this.version++;
  }
}
