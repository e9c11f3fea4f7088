// The data of the curves: values by name and frame, and those of abandoned branches.

import type { Curves } from "../../protocol";

export interface Series {
  frames: number[];
  values: Map<string, (number | null)[]>; // as long as `frames`
}
export interface Branch extends Series {
  first: number;
  line: string;
}

export class CurveData {
  now: Series = { frames: [], values: new Map() };
  branches: Branch[] = [];
  changes = 0; // number of changes, by which caches detect that they are stale

  take(curves: Curves): void {
    this.changes++;
    if (curves.reset) this.forget(curves.frames[0]);
    if (curves.branches)
      this.branches = curves.branches.map((branch) => ({ ...branch, values: new Map(Object.entries(branch.values)) }));
    const { frames, values } = this.now;
    const start = frames.length;
    for (const name of Object.keys(curves.values)) if (!values.has(name)) values.set(name, new Array<null>(start).fill(null));
    curves.frames.forEach((frame, k) => {
      const last = frames.at(-1);
      const at = last === undefined || frame > last ? frames.push(frame) - 1 : frames.indexOf(frame);
      if (at < 0) return; // older than the stored data
      for (const [name, all] of values) all[at] = curves.values[name]?.[k] ?? (at < start ? (all[at] ?? null) : null);
    });
  }

  get names(): string[] {
    return [...this.now.values.keys()];
  }

  /** Return the value at a frame. If it has not arrived yet, return the last one before. */
  valueAt(name: string, frame: number): number | null {
    const at = nearest(this.now.frames, frame);
    return at < 0 ? null : (this.now.values.get(name)?.[at] ?? null);
  }

  private forget(from: number | undefined): void {
    const { frames, values } = this.now;
    const keep = from === undefined ? 0 : frames.findIndex((frame) => frame >= from);
    if (keep < 0) return;
    frames.length = keep;
    for (const [name, all] of values) {
      all.length = keep;
      if (keep === 0) values.delete(name);
    }
  }
}

/** Return the index of the last of the sorted frames that is not after `frame`; -1 if all are after it. */
export function nearest(frames: readonly number[], frame: number): number {
  let low = 0;
  let high = frames.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if ((frames[middle] as number) <= frame) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}
