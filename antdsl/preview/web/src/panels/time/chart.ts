// The drawing of the curves: state counts on a common scale, each other curve on its own scale, specs as bands below.

import type { Store } from "../../store";
import { dark } from "../theme";
import { chosen } from "./chooser";
import { type CurveData, nearest, type Series } from "./data";
import type { Named } from "./naming";

export const EDGE = 8; // px on both sides: half the slider's thumb, so that frames are in line with the slider
const BAND = 5;

export class Chart {
  hover: number | null = null;
  stops: ReadonlyMap<number, string> = new Map(); // by frame: why play stopped there
  drawn: (() => void) | null = null;
  private readonly context: CanvasRenderingContext2D;
  private width = 0;
  private height = 0;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly store: Store,
    private readonly data: CurveData,
  ) {
    this.context = canvas.getContext("2d") as CanvasRenderingContext2D;
  }

  /** Return the simulated frame at a horizontal position of the canvas. */
  frameAt(x: number): number | null {
    const status = this.store.now.status;
    if (!status || this.width <= 2 * EDGE) return null;
    const share = Math.min(1, Math.max(0, (x - EDGE) / (this.width - 2 * EDGE)));
    return Math.round(status.first + share * Math.max(1, status.head - status.first));
  }

  draw(): void {
    this.fit();
    const status = this.store.now.status;
    const pen = this.context;
    pen.clearRect(0, 0, this.width, this.height);
    if (!status || !this.width) return;
    const specs = chosen.shown.filter((each) => each.group === "specs");
    const below = this.height - 2 - specs.length * (BAND + 2);
    this.lines(below);
    for (const [k, spec] of specs.entries()) this.band(spec, below + 3 + k * (BAND + 2));
    const words = getComputedStyle(this.canvas).getPropertyValue("color");
    this.upright(status.frame, words, 1);
    this.end(words);
    for (const frame of this.stops.keys()) this.stop(frame);
    if (this.hover !== null) this.upright(this.hover, words, 0.4);
    this.drawn?.();
  }

  private fit(): void {
    const ratio = devicePixelRatio || 1;
    const { clientWidth, clientHeight } = this.canvas;
    this.width = clientWidth;
    this.height = clientHeight;
    const [wide, high] = [Math.round(clientWidth * ratio), Math.round(clientHeight * ratio)];
    if (this.canvas.width !== wide || this.canvas.height !== high) [this.canvas.width, this.canvas.height] = [wide, high];
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
  }

  private x(frame: number): number {
    const { first, head } = this.store.now.status as { first: number; head: number };
    return EDGE + ((frame - first) / Math.max(1, head - first)) * (this.width - 2 * EDGE);
  }

  private upright(frame: number, colour: string, strength: number): void {
    const pen = this.context;
    pen.globalAlpha = strength;
    pen.strokeStyle = colour;
    pen.lineWidth = 1;
    const x = Math.round(this.x(frame)) + 0.5;
    pen.beginPath();
    pen.moveTo(x, 0);
    pen.lineTo(x, this.height);
    pen.stroke();
    pen.globalAlpha = 1;
  }

  /** Draw the last frame of the scene, if the run has reached it. */
  private end(colour: string): void {
    const last = this.store.now.scene?.last;
    const { first, head } = this.store.now.status as { first: number; head: number };
    if (last === undefined || last < first || last > head) return;
    this.context.setLineDash([2, 3]);
    this.upright(last, colour, 0.7);
    this.context.setLineDash([]);
  }

  private stop(frame: number): void {
    const { first, head } = this.store.now.status as { first: number; head: number };
    if (frame < first || frame > head) return;
    const x = this.x(frame);
    const pen = this.context;
    pen.fillStyle = dark() ? "#ff8278" : "#b3261e";
    pen.beginPath();
    pen.moveTo(x - 4, 0);
    pen.lineTo(x + 4, 0);
    pen.lineTo(x, 7);
    pen.fill();
  }

  private lines(below: number): void {
    const plotted = chosen.shown.filter((each) => each.group !== "specs");
    const branch = this.data.branches.at(-1);
    const all = branch ? [this.data.now, branch] : [this.data.now];
    const states = top(
      plotted.filter((each) => each.group === "states"),
      all,
    );
    for (const each of plotted) {
      const high = each.group === "states" ? states : top([each], all);
      const y = (value: number) => below - 1 - (value / high) * (below - 6);
      if (branch) this.line(branch, each, y, [4, 3], 0.75);
      this.line(this.data.now, each, y, [], 1);
    }
  }

  private line(series: Series, each: Named, y: (value: number) => number, dash: number[], strength: number): void {
    const values = series.values.get(each.name);
    const { frames } = series;
    if (!values || !frames.length) return;
    const pen = this.context;
    pen.strokeStyle = each.colour;
    pen.globalAlpha = strength;
    pen.lineWidth = 1.5;
    pen.setLineDash(dash);
    pen.beginPath();
    const { first, head } = this.store.now.status as { first: number; head: number };
    const [from, to] = [Math.max(0, nearest(frames, first - 1)), nearest(frames, head)];
    const step = Math.max(1, Math.floor((to - from) / (2 * this.width))); // two values per pixel are enough
    let pen_down = false;
    for (let k = from; k <= to; k = k === to ? to + 1 : Math.min(to, k + step)) {
      const value = values[k];
      if (value === null || value === undefined) pen_down = false;
      else {
        const x = this.x(frames[k] as number);
        if (pen_down) pen.lineTo(x, y(value));
        else pen.moveTo(x, y(value));
        pen_down = true;
      }
    }
    pen.stroke();
    pen.setLineDash([]);
    pen.globalAlpha = 1;
  }

  /** Draw whether a spec held at each frame, with a bright colour where it failed. */
  private band(spec: Named, y: number): void {
    const { frames, values } = this.data.now;
    const held = values.get(spec.name);
    if (!held) return;
    let start = 0;
    for (let k = 1; k <= frames.length; k++) {
      if (k < frames.length && held[k] === held[start]) continue;
      const value = held[start];
      if (value !== null && value !== undefined) {
        this.context.fillStyle = value ? (dark() ? "#2f6b46" : "#a9d8b8") : dark() ? "#ff6a5e" : "#c62a20";
        const left = this.x(frames[start] as number);
        this.context.fillRect(left, y, Math.max(1, this.x(frames[Math.min(k, frames.length - 1)] as number) - left), BAND);
      }
      start = k;
    }
  }
}

/** Return an upper bound of the curves. */
function top(all: readonly Named[], series: readonly Series[]): number {
  let high = 0;
  for (const each of all)
    for (const one of series)
      for (const value of one.values.get(each.name) ?? []) if (value !== null && value > high) high = value;
  return high || 1;
}
