// What keys and buttons do with time: play, pause, one frame on or back.

import type { Store } from "../store";

export function toggle(store: Store): void {
  store.connection.ask({ op: store.now.status?.playing ? "pause" : "play" });
}

/** Some frames on or back. Past the last simulated one it simulates; before the first it stays. */
export function move(store: Store, frames: number): void {
  const status = store.now.status;
  if (!status) return;
  const to = Math.max(status.first, status.frame + frames);
  if (status.playing) store.connection.ask({ op: "pause" });
  if (to <= status.head) store.connection.ask({ op: "seek", frame: to, exact: true });
  else {
    if (status.frame < status.head) store.connection.ask({ op: "seek", frame: status.head, exact: true });
    store.connection.ask({ op: "step", count: to - Math.max(status.head, status.frame) });
  }
}

export function seek(store: Store, frame: number, exact = true): void {
  if (store.now.status?.playing) store.connection.ask({ op: "pause" });
  store.connection.ask({ op: "seek", frame, exact });
}

const OWN_KEYS = "input, select, textarea, [contenteditable], [role=tablist], [role=separator], [data-keys=own], dialog";

/** Keys that hold wherever nothing else wants them: space, left and right, comma and dot, home and end. */
export function listenToKeys(store: Store): void {
  document.addEventListener("keydown", (event) => {
    const path = event.composedPath()[0];
    const element = path instanceof Element ? path : null;
    if (event.ctrlKey || event.metaKey || event.altKey || element?.closest(OWN_KEYS)) return;
    if (event.key === " " && element?.closest("button, summary, a")) return; // it presses those
    const inView = Boolean(element?.closest("#view"));
    const frames = event.shiftKey ? 10 : 1;
    const acts: Record<string, () => void> = {
      " ": () => toggle(store),
      ".": () => move(store, 1),
      ",": () => move(store, -1),
      ">": () => move(store, 10),
      "<": () => move(store, -10),
    };
    if (!inView) {
      acts.ArrowRight = () => move(store, frames);
      acts.ArrowLeft = () => move(store, -frames);
      acts.Home = () => seek(store, store.now.status?.first ?? 0);
      acts.End = () => seek(store, store.now.status?.head ?? 0);
    }
    const act = acts[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  });
}
