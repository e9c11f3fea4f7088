// Play, pause, step and seek, for buttons and keys.

import type { Store } from "../store";

const LATE = 400; // ms after a request from which on a status is its result
let request: { playing: boolean; since: number } | null = null; // a request without a matching status yet: a long step can delay it

/** Return whether it plays, or will play after the pending request. */
export function playing(store: Store): boolean {
  return request?.playing ?? store.now.status?.playing ?? false;
}

export function toggle(store: Store): void {
  request = { playing: !playing(store), since: performance.now() };
  store.connection.ask({ op: request.playing ? "play" : "pause" });
  if (store.now.status) store.set("status", store.now.status); // shows the button at once
}

/** Forget the pending request after a status that matches it. */
export function watchStatus(store: Store): void {
  store.connection.on("status", (status) => {
    if (!request) return;
    const done = status.playing === request.playing;
    if (!done && performance.now() - request.since < LATE) return;
    request = null;
    if (!done) store.set("status", status); // something else stopped it, such as a breakpoint
  });
}

/** Move by some frames. Beyond the last simulated frame it simulates; before the first frame it stops. */
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

/** Keys that work unless another element uses them: space, left, right, comma, dot, home and end. */
export function listenToKeys(store: Store): void {
  document.addEventListener("keydown", (event) => {
    const path = event.composedPath()[0];
    const element = path instanceof Element ? path : null;
    if (event.ctrlKey || event.metaKey || event.altKey || element?.closest(OWN_KEYS)) return;
    if (event.key === " " && element?.closest("button, summary, a")) return; // here, space activates the element
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
