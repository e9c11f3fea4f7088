// What keys and buttons do with time: play, pause, one frame on or back.

import type { Store } from "../store";

const LATE = 400; // ms after which what is told comes from behind what was asked
let wish: { playing: boolean; since: number } | null = null; // asked for, and not told yet: a long step may lie between

/** Whether it plays, or will as soon as what was asked is done. */
export function playing(store: Store): boolean {
  return wish?.playing ?? store.now.status?.playing ?? false;
}

export function toggle(store: Store): void {
  wish = { playing: !playing(store), since: performance.now() };
  store.connection.ask({ op: wish.playing ? "play" : "pause" });
  if (store.now.status) store.set("status", store.now.status); // the button shows it at once
}

/** Forget the wish once what is told is about it. */
export function heedStatus(store: Store): void {
  store.connection.on("status", (status) => {
    if (!wish) return;
    const done = status.playing === wish.playing;
    if (!done && performance.now() - wish.since < LATE) return;
    wish = null;
    if (!done) store.set("status", status); // it was stopped otherwise, such as by a breakpoint
  });
}

/** Some frames on or back. Past the last simulated one it simulates; before the first it stays. */
export function move(store: Store, frames: number): void {
  const status = store.now.status;
  if (!status) return;
  const to = Math.max(status.first, status.frame + frames);
  if (playing(store)) toggle(store);
  if (to <= status.head) store.connection.ask({ op: "seek", frame: to, exact: true });
  else {
    if (status.frame < status.head) store.connection.ask({ op: "seek", frame: status.head, exact: true });
    store.connection.ask({ op: "step", count: to - Math.max(status.head, status.frame) });
  }
}

export function seek(store: Store, frame: number, exact = true): void {
  if (playing(store)) toggle(store);
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
