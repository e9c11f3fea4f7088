// What pushed the agent that is explained: an arrow for each layer, solid as far as it got its way and pale where it was cut,
// their sum, the velocity that came of it, and lines to the neighbours it looked at. A key in the corner names them.

import * as THREE from "three";
import { HUES } from "../../hues";
import type { Explanation } from "../../explanation";
import type { Explained, Triple } from "../../protocol";
import type { Sight } from "../sight";
import { Strokes } from "../strokes";

const FAR = 5; // body lengths that an arrow of length 1 is long

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
    const told = store.now.explained;
    const now = told !== null && current(sight, told);
    if (now) {
      if (store.now.neighbours) neighbours(told);
      layers(told);
    }
    name(now ? told : null);
    for (const strokes of [arrows, cut]) if (strokes.count || strokes.object.visible) strokes.done();
  }

  function neighbours(told: Explained): void {
    for (const each of told.neighbours) {
      arrows.add(told.place as Triple, 0, each, 0, 1.2, 1.2, stage.palette.ink, 0.55);
      arrows.pale(0.5);
    }
  }

  function layers(told: Explained): void {
    const { explanation, place } = told;
    if (!explanation || !place) return;
    const herd = herds.byName.get(told.species);
    const size = herd?.size(herd.row(told.agent)) ?? 1;
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

  function name(told: Explained | null): void {
    const rows = keyRows(told?.explanation?.layers ?? [], stage.palette);
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

/** What the key says of the arrows: the layers that pushed, then what came of them. */
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

/** Whether the explanation is of the agent one looks at, at the frame that is shown. */
function current(sight: Sight, told: Explained): boolean {
  const last = sight.store.now.selected.at(-1);
  if (!told.explanation || !told.place || !last) return false;
  return told.species === last.species && told.agent === last.id && told.frame === sight.herds.frame;
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
