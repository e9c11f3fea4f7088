// The colour of each agent: its natural one, by state, speed or any attribute. One entry for each way.

import type { Attribute, NumberArray, Species, Triple } from "../../protocol";
import { NATURAL } from "../../store";
import type { Herd } from "./herd";
import { RAMP } from "../palette";

/** How numbers become colours: the ends of the colour ramp, in `unit`. */
export interface Range {
  low: number;
  high: number;
  unit: string;
}

const PLAIN: Triple = [0.62, 0.6, 0.57];

/** Return the machine of the displayed states, if agents are coloured by states. */
export function machineOf(species: Species, colour: string) {
  if (colour === "state") return species.machines[0];
  return colour.startsWith("state/") ? species.machines.find((each) => each.name === colour.slice(6)) : undefined;
}

/** Return the numbers that set the colour, or undefined if the species has none. */
export function numbersOf(herd: Herd, colour: string): { values: NumberArray; unit: string } | undefined {
  if (colour === "speed") {
    const values = herd.column("speed");
    return values && { values, unit: "mm/s" };
  }
  const about: Attribute | undefined = herd.species.attributes.find((each) => each.name === colour);
  const values = about && herd.column(`column/${colour}`);
  return values && about && { values, unit: about.unit };
}

/** Set the colours of all rows. `range`: start and end of the colour ramp. Colours of edits override all others. */
export function paint(herd: Herd, colour: string, range: Range | null): void {
  paintValues(herd, colour, range);
  const tint = herd.column("tint");
  for (let row = 0; tint && row < herd.count; row++)
    if (tint[4 * row + 3]) herd.rows.tone.set(tint.subarray(4 * row, 4 * row + 3) as Uint8Array, 4 * row);
}

function paintValues(herd: Herd, colour: string, range: Range | null): void {
  const { tone } = herd.rows;
  const natural = colour === NATURAL ? herd.natural : null;
  if (natural) {
    const { table, trait, steps } = natural;
    const group = herd.gaze.groups.indexOf(`trait/${Math.floor(trait / 3)}`);
    for (let row = 0; row < herd.count; row++) {
      const step = group < 0 ? 0 : Math.round(herd.gaze.value(row, group, trait % 3) * steps);
      copy(tone, row, table, Math.min(step, table.length / 3 - 1));
    }
    return;
  }
  const machine = machineOf(herd.species, colour);
  const states = machine && herd.column(`state/${machine.name}`);
  if (machine && states) {
    const table = Uint8Array.from(machine.colours.flat(), (part) => Math.round(255 * part));
    const plain = PLAIN.map((part) => Math.round(255 * part));
    const entries = Uint8Array.from([...table, ...plain]); // the last colour is for states of an earlier program
    const known = machine.colours.length;
    for (let row = 0; row < herd.count; row++) copy(tone, row, entries, Math.min(states[row] as number, known));
    return;
  }
  const found = range && numbersOf(herd, colour);
  if (found) {
    const scale = 255 / (range.high - range.low || 1);
    for (let row = 0; row < herd.count; row++) {
      const part = ((found.values[row] as number) - range.low) * scale;
      copy(tone, row, RAMP, part >= 0 ? Math.min(Math.round(part), 255) : 0);
    }
    return;
  }
  const plain = Uint8Array.from(PLAIN, (part) => Math.round(255 * part));
  for (let row = 0; row < herd.count; row++) copy(tone, row, plain, 0);
}

/** Set the colours of a species with several bodies to those of its bodies. */
export function paintFromBodies(herd: Herd, bodies: readonly Herd[]): void {
  const number = herd.column("body");
  const next = bodies.map(() => 0);
  for (let row = 0; row < herd.count; row++) {
    const body = (number?.[row] as number | undefined) ?? 0;
    const at = next[body] as number;
    next[body] = at + 1;
    copy(herd.rows.tone, row, (bodies[body] as Herd).rows.tone.subarray(4 * at, 4 * at + 3), 0);
  }
}

function copy(tone: Uint8Array, row: number, table: Uint8Array, entry: number): void {
  tone[4 * row] = table[3 * entry] as number;
  tone[4 * row + 1] = table[3 * entry + 1] as number;
  tone[4 * row + 2] = table[3 * entry + 2] as number;
  tone[4 * row + 3] = 255;
}

/** A smoothed range of the displayed values: it widens at once, and narrows only when most of it is unused. */
export function ranged(herds: Iterable<Herd>, colour: string, before: Range | null): Range | null {
  let low = Number.POSITIVE_INFINITY;
  let high = Number.NEGATIVE_INFINITY;
  let unit = "";
  for (const herd of herds) {
    const found = numbersOf(herd, colour);
    if (!found) continue;
    unit = found.unit;
    for (let row = 0; row < herd.count; row++) {
      const value = found.values[row] as number;
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  if (low > high) return before;
  if (low > 0 && low < 0.5 * high) low = 0;
  const fits = before && before.unit === unit && low >= before.low && high <= before.high;
  if (fits && high - low > 0.35 * (before.high - before.low)) return before;
  const step = 10 ** Math.floor(Math.log10(Math.max(high - low, 1e-9))) / 2;
  return { low: Math.floor(low / step) * step, high: Math.ceil(high / step) * step || step, unit };
}
