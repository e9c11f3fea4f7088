// Where the agents of one species look, how they lean and how their bodies differ, row by row for the shaders: previous and
// current values.

import type { NumberArray } from "../../protocol";

const PART = 8; // numbers of a group: previous and current direction, four each
const WHOLE = 127;

export class Gaze {
  data = new Float32Array(0);
  groups: string[] = [];
  version = 0; // increases with each frame
  private was = new Float32Array(0);

  /** Numbers per row. */
  get width(): number {
    return PART * this.groups.length;
  }

  begin(groups: string[]): void {
    this.groups = groups;
    this.data = new Float32Array(0);
    this.was = this.data;
    this.version++;
  }

  /** Return one of the three current numbers of a group of a row; 0 without data. */
  value(row: number, group: number, axis: number): number {
    return this.data[row * this.width + PART * group + PART / 2 + axis] ?? 0;
  }

  /** Take a frame: for each group int8 [n, 3] (127 is 1), for traits float32 [n, 3], or undefined for no data. `from`: the previous
   * row of each row, or -1. Rows continue from the displayed values, `t` of the way between frames. */
  take(values: (NumberArray | undefined)[], count: number, from: Int32Array, t: number): void {
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
        const now = values[group];
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
