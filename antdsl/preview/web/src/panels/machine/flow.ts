// Rates of state changes, from the total counts that the server sends with each frame.

import type { Chart } from "../../protocol";
import type { Store } from "../../store";

interface Sample {
  frame: number;
  counts: Record<string, number>;
}

export class Flow {
  private readonly samples: Sample[] = [];

  constructor(private readonly store: Store) {
    store.on("status", () => this.take());
    store.on("scene", () => {
      this.samples.length = 0;
    });
  }

  /** Return changes per second of scene time over about the last second, by `from->to`; empty if unknown. */
  rates(chart: Chart): Map<string, number> {
    const rates = new Map<string, number>();
    const last = this.samples.at(-1);
    const first = this.samples[0];
    const fps = this.store.now.scene?.fps ?? 0;
    if (!last || !first || last === first || !fps) return rates;
    const seconds = (last.frame - first.frame) / fps;
    const before = `${chart.species}.`;
    for (const [name, count] of Object.entries(last.counts)) {
      const went = count - (first.counts[name] ?? 0);
      if (went > 0 && name.startsWith(before)) rates.set(name.slice(before.length), went / seconds);
    }
    return rates;
  }

  private take(): void {
    const status = this.store.now.status;
    const fps = this.store.now.scene?.fps ?? 24;
    if (!status?.transitions || status.light) return;
    const last = this.samples.at(-1);
    if (last && last.frame === status.frame) return;
    if (last && last.frame > status.frame) this.samples.length = 0; // the frame is earlier than before
    this.samples.push({ frame: status.frame, counts: status.transitions });
    while (this.samples.length > 2 && (this.samples[1] as Sample).frame <= status.frame - fps) this.samples.shift();
  }
}
