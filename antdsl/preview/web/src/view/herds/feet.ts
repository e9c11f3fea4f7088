// The feet of the agents of one species, and the position of their trunks above them, row by row for the shaders: previous and
// current values.

import type { NumberArray } from "../../protocol";

export const STANCE = 3; // texels of four numbers before those of feet: previous rise and tilt, current rise and tilt, share of standing feet
const LENGTH = 4096; // units per body length
const WHOLE = 32767;

export class Feet {
  data = new Float32Array(0);
  version = 0; // increases with each frame
  hasData = false; // whether a frame contained feet
  private legs = 0;
  private flat = false;
  private was = new Float32Array(0);

  /** Numbers per row. */
  get width(): number {
    return 4 * (STANCE + this.texels * this.legs);
  }

  /** Texels per leg: previous and current foothold, then, after those of all legs, direction across its sole. */
  get texels(): number {
    return this.flat ? 4 : 2;
  }

  begin(legs: number, flat: boolean): void {
    this.legs = legs;
    this.flat = flat;
    this.data = new Float32Array(0);
    this.was = this.data;
    this.hasData = false;
    this.version++;
  }

  /** Take a frame: `places` int16 [n, legs, 3], `stances` int16 [n, 6], `soles` int16 [n, legs, 3]. Without data the values
   * stay. `from`: the previous row of each row, or -1. Rows continue from the displayed values, `t` of the way between frames. */
  take([places, stances, soles]: readonly (NumberArray | undefined)[], count: number, from: Int32Array, t: number): void {
    const { width, legs } = this;
    if (legs === 0 || !(this.hasData || places)) return;
    [this.was, this.data] = [this.data, this.was];
    if (this.data.length < count * width) this.data = new Float32Array(Math.ceil(count * 1.3 + 8) * width);
    const { was } = this;
    for (let row = 0; row < count; row++) {
      const k = row * width;
      const other = (from[row] as number) * width;
      const known = this.hasData && other >= 0 && other + width <= was.length;
      if (places && stances) this.go(k, places, stances, row);
      if (soles && this.flat) this.turn(k, soles, row);
      const isGiven = places !== undefined;
      for (let part = 0; part < 4; part++) this.step(k + part, 4, known ? other + part : -1, t, isGiven);
      this.step(k + 8, 1, known ? other + 8 : -1, t, isGiven);
      for (let foot = 4 * STANCE; foot < width; foot += 8)
        for (let part = 0; part < 4; part++) this.step(k + foot + part, 4, known ? other + foot + part : -1, t, isGiven);
    }
    this.hasData = true;
    this.version++;
  }

  /** Write the new values of a row. */
  private go(k: number, places: NumberArray, stances: NumberArray, row: number): void {
    const { data, legs } = this;
    const at = 6 * row;
    data[k + 4] = (stances[at] as number) / LENGTH;
    for (let axis = 0; axis < 3; axis++) data[k + 5 + axis] = (stances[at + 1 + axis] as number) / WHOLE;
    data[k + 9] = (stances[at + 4] as number) / WHOLE;
    const down = stances[at + 5] as number;
    for (let leg = 0; leg < legs; leg++) {
      const foot = k + 4 * STANCE + 8 * leg + 4;
      for (let axis = 0; axis < 3; axis++) data[foot + axis] = (places[3 * (row * legs + leg) + axis] as number) / LENGTH;
      data[foot + 3] = (down >> leg) & 1;
    }
  }

  /** Write the new directions of the soles of a row. */
  private turn(k: number, soles: NumberArray, row: number): void {
    for (let leg = 0; leg < this.legs; leg++) {
      const sole = k + 4 * (STANCE + 2 * this.legs + 2 * leg) + 4;
      for (let axis = 0; axis < 3; axis++) this.data[sole + axis] = (soles[3 * (row * this.legs + leg) + axis] as number) / WHOLE;
    }
  }

  /** Set the previous value `k` of a number from the displayed value, or from the new value `k + apart` if there was none. */
  private step(k: number, apart: number, before: number, t: number, isGiven: boolean): void {
    const { data, was } = this;
    const shown =
      before < 0 ? (isGiven ? (data[k + apart] as number) : 0) : mixed(was[before] as number, was[before + apart] as number, t);
    data[k] = shown;
    if (!isGiven) data[k + apart] = shown;
  }
}

function mixed(a: number, b: number, t: number): number {
  return a + (b - a) * t;
}
