// The meaning of the colours, with current counts. A click on the row of a state selects its agents. With natural colours, states
// have no colour here.

import type { Machine, Species } from "../../protocol";
import { type Agent, NATURAL } from "../../store";
import { Colouring } from "../herds/colouring";
import { machineOf, numbersOf } from "../herds/colours";
import type { Herd } from "../herds/herd";
import { RAMP } from "../palette";
import type { Sight } from "../sight";

const EVERY = 120; // ms between two counts

export function legend(sight: Sight): void {
  const { stage, store, herds } = sight;
  const colouring = new Colouring(sight);
  const box = document.createElement("div");
  box.className = "sight-legend";
  box.setAttribute("role", "group");
  box.setAttribute("aria-label", "Colours");
  stage.place.append(box);
  const folded = new Set<string>();
  let made = "";
  let counts: (() => void)[] = [];
  let next = 0;
  let waits = false;

  function refresh(): void {
    const { colour, scene } = store.now;
    const what = JSON.stringify([colour, colouring.range, scene?.species.map((each) => [each.name, each.machines])]);
    if (what !== made) build(colour);
    made = what;
    const now = performance.now();
    if (now >= next) {
      next = now + EVERY;
      for (const count of counts) count();
    } else if (!waits) {
      waits = true;
      setTimeout(() => {
        waits = false;
        refresh();
      }, next - now);
    }
  }

  function build(colour: string): void {
    counts = [];
    box.replaceChildren();
    let ramp = false;
    for (const herd of herds.byName.values()) {
      const machine = machineOf(herd.species, colour === NATURAL ? "state" : colour);
      if (machine) states(herd, machine, colour !== NATURAL);
      else if (numbersOf(herd, colour)) ramp = true;
    }
    if (ramp && colouring.range) box.append(bar(colour, colouring.range.low, colouring.range.high, colouring.range.unit));
    box.hidden = box.childElementCount === 0;
    next = 0;
  }

  function states(herd: Herd, machine: Machine, coloured: boolean): void {
    const part = document.createElement("details");
    const title = document.createElement("summary");
    const id = `${herd.species.name} ${machine.name}`;
    part.open = !folded.has(id);
    part.addEventListener("toggle", () => (part.open ? folded.delete(id) : folded.add(id)));
    part.append(title);
    box.append(part);
    const several = herd.species.machines.length > 1 ? ` · ${machine.name}` : "";
    const rows = machine.states.map((_, number) => row(sight, herd.species, machine, number, coloured));
    for (const each of rows) part.append(each.button);
    counts.push(() => {
      const now = herds.byName.get(herd.species.name) ?? herd; // an edit replaces the herds; their states stay the same
      title.textContent = `${herd.species.name}${several} · ${now.count.toLocaleString("en")}`;
      const found = tally(now, machine);
      rows.forEach((each, number) => {
        each.count.textContent = (found[number] as number).toLocaleString("en");
      });
    });
  }

  colouring.onChange(refresh);
}

/** Return the row of a state with its count, and with its colour if agents have it. A click selects the agents in this state. */
function row({ herds, store }: Sight, species: Species, machine: Machine, number: number, coloured: boolean) {
  const state = machine.states[number] as string;
  const button = document.createElement("button");
  button.type = "button";
  button.title = `select who is in ${state}`;
  button.dataset.test = `legend-${species.name}-${machine.name}-${state}`;
  const swatch = document.createElement("i");
  swatch.style.background = `rgb(${machine.colours[number]?.map((part) => Math.round(255 * part)).join(" ")})`;
  const name = document.createElement("span");
  name.textContent = state;
  const count = document.createElement("b");
  button.append(...(coloured ? [swatch] : []), name, count);
  button.addEventListener("click", () => {
    const herd = herds.byName.get(species.name);
    const states = herd?.column(`state/${machine.name}`);
    if (!herd || !states) return;
    const found: Agent[] = [];
    for (let k = 0; k < herd.count; k++)
      if (states[k] === number) found.push({ species: species.name, id: herd.ids[k] as number });
    store.set("selected", found);
  });
  return { button, count };
}

/** Return the number of agents in each state of a machine. */
export function tally(herd: Herd, machine: Machine): number[] {
  const found = new Array<number>(machine.states.length).fill(0);
  const states = herd.column(`state/${machine.name}`);
  for (let at = 0; states && at < herd.count; at++) {
    const state = states[at] as number;
    if (state < found.length) found[state] = (found[state] as number) + 1;
  }
  return found;
}

function bar(name: string, low: number, high: number, unit: string): HTMLElement {
  const box = document.createElement("div");
  box.className = "sight-ramp";
  const title = document.createElement("h3");
  title.textContent = unit ? `${name} (${unit})` : name;
  const canvas = document.createElement("canvas");
  canvas.width = 256;
  canvas.height = 1;
  const context = canvas.getContext("2d") as CanvasRenderingContext2D;
  const image = context.createImageData(256, 1);
  for (let k = 0; k < 256; k++)
    image.data.set([RAMP[3 * k] as number, RAMP[3 * k + 1] as number, RAMP[3 * k + 2] as number, 255], 4 * k);
  context.putImageData(image, 0, 0);
  const ends = document.createElement("p");
  for (const value of [low, (low + high) / 2, high]) {
    const word = document.createElement("span");
    word.textContent = Number(value.toPrecision(3)).toLocaleString("en");
    ends.append(word);
  }
  box.append(title, canvas, ends);
  return box;
}
