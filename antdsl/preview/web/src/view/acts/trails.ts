// Trails: where agents were lately. Drawn for the selected agents; without a selection for all agents, unless they are too many.

import * as THREE from "three";
import type { NumberArray } from "../../protocol";
import type { Herd } from "../herds/herd";
import type { Sight } from "../sight";
import { Strokes } from "../strokes";

const LONG = 96; // frames
const FEW = 300; // maximum number of agents with trails if none is selected
const MOST = 60; // maximum number of selected agents with trails

interface Past {
  frame: number;
  ids: NumberArray;
  place: Float32Array;
}

export function trails(sight: Sight): void {
  const { stage, store, herds } = sight;
  const past = new Map<string, Past[]>();
  const strokes = new Strokes(stage, { order: 6 });
  const colour = new THREE.Color();
  const note = document.createElement("p");
  note.className = "sight-note";
  note.dataset.test = "trails-note";
  note.setAttribute("role", "status");
  note.hidden = true;
  stage.place.append(note);

  function remember(): void {
    for (const [name, herd] of herds.byName) {
      const history = past.get(name) ?? [];
      while (history.length && (history.at(-1) as Past).frame >= herds.frame) history.pop(); // after a step back, forget later frames
      if (history.length && herds.frame - (history.at(-1) as Past).frame > 48) history.length = 0;
      const place = herd.column("position");
      if (place) history.push({ frame: herds.frame, ids: herd.ids, place: Float32Array.from(place) });
      if (history.length > LONG) history.shift();
      past.set(name, history);
    }
  }

  function draw(): void {
    strokes.clear();
    const { trails: isEnabled, selected } = store.now;
    if (isEnabled) {
      for (const [name, herd] of herds.byName) {
        const history = past.get(name) ?? [];
        const ids = selected.filter((agent) => agent.species === name).slice(-MOST);
        if (ids.length) for (const agent of ids) trail(history, agent.id, herd, 2.2, true);
        else if (selected.length === 0 && herds.count <= FEW) for (const id of herd.ids) trail(history, id, herd, 1.2, false);
      }
    }
    if (strokes.count || strokes.object.visible) strokes.done();
    const words = isEnabled ? missing(selected.length, herds.count, strokes.count) : "";
    note.hidden = !words;
    if (note.textContent !== words) note.textContent = words;
  }

  function trail(history: Past[], id: number, herd: Herd, wide: number, marked: boolean): void {
    const row = herd.row(id);
    if (row < 0) return;
    if (marked) colour.copy(stage.palette.mark);
    else colour.setRGB(part(herd, row, 0), part(herd, row, 1), part(herd, row, 2), THREE.SRGBColorSpace);
    let before: Past | null = null;
    let at = -1;
    history.forEach((now, number) => {
      const here = rowOf(now, id, row);
      if (before && at >= 0 && here >= 0 && near(before.place, at, now.place, here, herd.size(row))) {
        const age = number / history.length;
        strokes.add(before.place, 3 * at, now.place, 3 * here, wide * age, wide * age, colour, 0.75 * age);
      }
      before = now;
      at = here;
    });
  }

  herds.onFrame(() => {
    remember();
    draw();
  });
  herds.onPeople(() => past.clear());
  store.on(["trails", "selected"], draw);
}

/** Return why trails are missing; empty if they are complete. */
export function missing(chosen: number, all: number, drawn: number): string {
  if (chosen > MOST) return `trails of the last ${MOST} of ${chosen.toLocaleString("en")} that are selected`;
  if (!chosen && all > FEW)
    return `no trails: ${all.toLocaleString("en")} are too many at once — select those whose trails you want to see`;
  return drawn ? "" : "no trails yet: they grow as it plays";
}

function part(herd: Herd, row: number, axis: number): number {
  return (herd.rows.tone[4 * row + axis] as number) / 255;
}

/** Return the row of an id in an earlier frame, or -1. `guess` is right in most frames. */
function rowOf(past: Past, id: number, guess: number): number {
  if (past.ids[guess] === id) return guess;
  let low = 0;
  let high = past.ids.length - 1;
  while (low <= high) {
    const middle = (low + high) >> 1;
    const found = past.ids[middle] as number;
    if (found === id) return middle;
    if (found < id) low = middle + 1;
    else high = middle - 1;
  }
  return -1;
}

/** Return whether an agent can have walked from one position to the other. Agents that were moved elsewhere get no line. */
function near(a: Float32Array, i: number, b: Float32Array, k: number, size: number): boolean {
  const far = Math.hypot(
    (a[3 * i] as number) - (b[3 * k] as number),
    (a[3 * i + 1] as number) - (b[3 * k + 1] as number),
    (a[3 * i + 2] as number) - (b[3 * k + 2] as number),
  );
  return far < 40 * size;
}
