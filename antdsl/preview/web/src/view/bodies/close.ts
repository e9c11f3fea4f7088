// The few agents that appear large, drawn in full detail. The crowd is drawn without their rows.

import * as THREE from "three";
import { Figure, type Form } from "./figure";
import { type Herd, Rows } from "../herds/herd";
import { changed, rowAttributes } from "./shapes";
import type { Stage } from "../stage";

const LARGE = 24; // px of a body's length on the screen
const MOST = { software: 40, hardware: 400 };
const POINT = new THREE.Vector3();

export class Close {
  private readonly rows = new Rows();
  private readonly figure: Figure;
  private attributes = new Map<string, THREE.InstancedBufferAttribute>();
  private chosen: number[] = []; // rows, sorted
  private readonly found: number[] = [];
  private far = new Float32Array(0); // distance of each row

  constructor(
    private readonly stage: Stage,
    private readonly herd: Herd,
    private readonly marked: () => void, // called when the set of left-out rows changes
  ) {
    this.figure = new Figure(stage);
    this.rows.reserve(MOST[stage.software ? "software" : "hardware"]);
  }

  /** Return the drawn figure of an agent that is drawn in full, with its index: for tests. */
  posed(row: number): { figure: Figure; place: number } | null {
    const place = this.chosen.indexOf(row);
    return place < 0 ? null : { figure: this.figure, place };
  }

  forget(): void {
    this.figure.form = null;
  }

  show(form: Form, t: number): void {
    if (form !== this.figure.form) this.build(form);
    const before = this.chosen;
    this.chosen = this.near(t);
    const { rows, herd } = this;
    const same = before.length === this.chosen.length && before.every((row, k) => row === this.chosen[k]);
    if (!same) for (const row of before) if (row < herd.count) herd.rows.tone[4 * row + 3] = 255;
    let hidden = same;
    this.chosen.forEach((row, k) => {
      rows.copy(k, herd.rows, row);
      hidden &&= herd.rows.tone[4 * row + 3] === 0;
      for (let part = 0; part < 3; part++) rows.tone[4 * k + part] = herd.rows.tone[4 * row + part] as number;
      rows.tone[4 * k + 3] = 255;
      herd.rows.tone[4 * row + 3] = 0;
    });
    if (!hidden) this.marked();
    for (const attribute of this.attributes.values()) changed(attribute, this.chosen.length);
    this.figure.show(this.chosen.length, t, herd, this.chosen);
  }

  dispose(): void {
    this.figure.dispose();
  }

  /** Return the rows of agents that appear large, the nearest ones if there are many. */
  private near(t: number): number[] {
    const { herd, found } = this;
    if (this.far.length < herd.count) this.far = new Float32Array(herd.rows.capacity);
    const { far } = this;
    const eye = this.stage.camera.position;
    const most = MOST[this.stage.software || this.stage.slow ? "software" : "hardware"];
    found.length = 0;
    for (let row = 0; row < herd.count; row++) {
      herd.place(row, t, POINT);
      far[row] = POINT.distanceTo(eye);
      if ((far[row] as number) * LARGE < herd.size(row) * this.stage.focal) found.push(row);
    }
    if (found.length > most) found.sort((a, b) => (far[a] as number) - (far[b] as number)).length = most;
    return found.slice().sort((a, b) => a - b);
  }

  private build(form: Form): void {
    this.attributes = rowAttributes(this.rows);
    this.figure.take(form, this.attributes);
  }
}
