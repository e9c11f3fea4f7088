// Planned paths: where agents will be in the next seconds, simulated ahead by the server. A dashed line from an agent gets paler
// with time and ends in a knob. Drawn for the selected agents; without a selection for all agents, unless they are too many.

import * as THREE from "three";
import type { NumberArray, Packet } from "../../protocol";
import { MOST_PLANNED } from "../../protocol";
import type { Sight } from "../sight";
import { Strokes } from "../strokes";

export function paths(sight: Sight): void {
  const { stage, store, herds } = sight;
  const strokes = new Strokes(stage, { order: 7, dash: 9, through: true });
  const ends = new Strokes(stage, { order: 8, through: true });
  const colour = new THREE.Color();
  let latest: Packet | null = null;
  const note = document.createElement("p");
  note.className = "sight-note";
  note.dataset.test = "paths-note";
  note.setAttribute("role", "status");
  note.hidden = true;
  stage.place.append(note);

  function draw(): void {
    strokes.clear();
    ends.clear();
    const { paths: isEnabled, selected } = store.now;
    const marked = new Set(selected.map((agent) => `${agent.species} ${agent.id}`));
    for (const [name, ids, places, count] of isEnabled && latest ? planned(latest) : []) {
      const herd = herds.byName.get(name);
      ids.forEach((id, number) => {
        const chosen = marked.has(`${name} ${id}`);
        const row = herd?.row(id) ?? -1;
        if (!herd || row < 0 || (selected.length > 0 && !chosen)) return;
        if (chosen) colour.copy(stage.palette.mark);
        else
          colour.setRGB(
            part(herd.rows.tone, row, 0),
            part(herd.rows.tone, row, 1),
            part(herd.rows.tone, row, 2),
            THREE.SRGBColorSpace,
          );
        line(places, number * count, count, herds.frame - (latest?.header.frame ?? 0), chosen ? 2.4 : 1.3);
      });
    }
    for (const each of [strokes, ends]) if (each.count || each.object.visible) each.done();
    const words = isEnabled ? unseen(selected.length, herds.count, strokes.count) : "";
    note.hidden = !words;
    if (note.textContent !== words) note.textContent = words;
  }

  /** Return the part of a path from the displayed frame on. */
  function line(places: NumberArray, first: number, count: number, from: number, wide: number): void {
    if (from < 0) return;
    let last = from;
    for (let k = from; k + 1 < count && there(places, first + k + 1); k++) {
      const pale = 1 - (0.7 * (k - from)) / Math.max(count - from, 1);
      strokes.add(places, 3 * (first + k), places, 3 * (first + k + 1), wide, wide, colour, pale);
      last = k + 1;
    }
    if (last > from) ends.add(places, 3 * (first + last), places, 3 * (first + last), 3.2 * wide, 3.2 * wide, colour, 0.9);
  }

  store.connection.onPacket((packet) => {
    if (packet.slot !== "paths") return;
    latest = packet;
    draw();
  });
  herds.onFrame(draw);
  herds.onPeople(draw);
  store.on(["paths", "selected"], draw);
}

/** Return species, ids, positions (n, count, 3) and the number of frames. */
export function* planned(packet: Packet): Generator<[string, NumberArray, NumberArray, number]> {
  const count = packet.header.count ?? 0;
  for (const [key, places] of packet.arrays) {
    const name = key.endsWith("/path") ? key.slice(0, -"/path".length) : "";
    const ids = packet.arrays.get(`${name}/id`);
    if (name && ids) yield [name, ids, places, count];
  }
}

/** Return why planned paths are missing; empty if they are complete. */
export function unseen(chosen: number, all: number, drawn: number): string {
  if (chosen > MOST_PLANNED.chosen)
    return `planned paths of the last ${MOST_PLANNED.chosen} of ${chosen.toLocaleString("en")} that are selected`;
  if (!chosen && all > MOST_PLANNED.all)
    return `no planned paths: ${all.toLocaleString("en")} are too many at once — select those whose paths you want to see`;
  return drawn ? "" : "planned paths: being simulated";
}

function part(tone: ArrayLike<number>, row: number, axis: number): number {
  return (tone[4 * row + axis] as number) / 255;
}

function there(places: NumberArray, at: number): boolean {
  return !Number.isNaN(places[3 * at] as number);
}
