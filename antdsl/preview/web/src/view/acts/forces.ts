// The pushes on the explained agent. Each layer has an arrow: solid for its share, pale for the part that was cut. Further lines
// show the sum, the resulting velocity and the observed neighbours. A key in the corner names them.

import * as THREE from "three";
import { HUES } from "../../hues";
import type { Explanation } from "../../explanation";
import type { Explained, Triple } from "../../protocol";
import type { Sight } from "../sight";
import { Strokes } from "../strokes";

const FAR = 5; // body lengths of an arrow for a push of length 1

export function forces(sight: Sight): void {
  const { stage, store, herds } = sight;
  const arrows = new Strokes(stage, { order: 14, through: true });
  const cut = new Strokes(stage, { order: 14, dash: 7 });
  const key = document.createElement("ul");
  key.className = "sight-key";
  key.setAttribute("aria-label", "Arrows");
  key.hidden = true;
  stage.place.append(key);
  let named = "";

  function draw(): void {
    arrows.clear();
    cut.clear();
    const explained = store.now.explained;
    const now = explained !== null && current(sight, explained);
    if (now) {
      if (store.now.neighbours) neighbours(explained);
      layers(explained);
    }
    name(now ? explained : null);
    for (const strokes of [arrows, cut]) if (strokes.count || strokes.object.visible) strokes.done();
  }

  function neighbours(explained: Explained): void {
    for (const each of explained.neighbours) {
      arrows.add(explained.place as Triple, 0, each, 0, 1.2, 1.2, stage.palette.ink, 0.55);
      arrows.pale(0.5);
    }
  }

  function layers(explained: Explained): void {
    const { explanation, place } = explained;
    if (!explanation || !place) return;
    const herd = herds.byName.get(explained.species);
    const size = herd?.size(herd.row(explained.agent)) ?? 1;
    const root = place.map((part, axis) => part + stage.up.getComponent(axis) * size * 0.45) as Triple;
    const tip = (push: Triple, times: number) => root.map((part, axis) => part + (push[axis] as number) * times * size) as Triple;
    if (length(explanation.push) > 1e-4) arrows.arrow(root, tip(explanation.push, FAR), 6.5, stage.palette.ink, 0.6, 0.2); // below the others
    explanation.layers.forEach((layer, number) => {
      if (!layer.push || layer.length < 1e-4) return;
      const colour = layerColour(number);
      if (layer.cut > 1e-4) {
        const whole = tip(layer.push, FAR);
        cut.add(tip(layer.given, FAR), 0, whole, 0, 2.4, 2.4, colour, 0.75);
        arrows.add(whole, 0, whole, 0, 5, 5, colour, 0.75);
      }
      if (layer.share > 1e-4) arrows.arrow(root, tip(layer.given, FAR), 3, colour, 1, 0.22);
    });
    const velocity = explanation.velocity[1] ?? explanation.velocity[0];
    const speed = length(velocity);
    if (speed > 1e-6) arrows.arrow(root, tip(velocity, (FAR * 0.8) / speed), 1.8, stage.palette.mark, 1, 0.16);
  }

  function name(explained: Explained | null): void {
    const rows = keyRows(explained?.explanation?.layers ?? [], stage.palette);
    const all = JSON.stringify(rows);
    if (all === named) return;
    named = all;
    key.hidden = rows.length === 0;
    key.replaceChildren(...rows.map((row) => entry(...row)));
  }

  herds.onFrame(draw);
  store.on(["explained", "neighbours", "selected"], draw);
  stage.palette.onChange(draw);
}

type Layer = Explanation["layers"][number];
type KeyRow = [colour: string, words: string, cut: boolean];

/** Return the rows of the key: the layers with pushes, then their results. */
export function keyRows(layers: readonly Layer[], { ink, mark }: Record<"ink" | "mark", THREE.Color>): KeyRow[] {
  const rows: KeyRow[] = [];
  for (const [number, layer] of layers.entries()) {
    if (layer.push && layer.length >= 1e-4) rows.push([HUES[number % HUES.length] as string, layer.place.text, layer.cut > 1e-4]);
  }
  if (!rows.length) return [];
  return [
    ...rows,
    [`#${ink.getHexString()}`, "all layers together", false],
    [`#${mark.getHexString()}`, "velocity, after", false],
  ];
}

/** Return whether the explanation is of the selected agent at the displayed frame. */
function current(sight: Sight, explained: Explained): boolean {
  const last = sight.store.now.selected.at(-1);
  if (!explained.explanation || !explained.place || !last) return false;
  return explained.species === last.species && explained.agent === last.id && explained.frame === sight.herds.frame;
}

function layerColour(number: number): THREE.Color {
  return new THREE.Color(HUES[number % HUES.length]);
}

function length(way: Triple): number {
  return Math.hypot(...way);
}

function entry(colour: string, text: string, cut: boolean): HTMLElement {
  const row = document.createElement("li");
  const swatch = document.createElement("i");
  swatch.style.background = colour;
  const words = document.createElement("span");
  words.textContent = text;
  words.title = text;
  row.append(swatch, words);
  if (cut) {
    const note = document.createElement("em");
    note.textContent = "cut";
    row.append(note);
  }
  return row;
}
