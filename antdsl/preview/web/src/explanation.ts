// The explanation of an agent's step: the output of `antdsl explain --json`.

import type { Triple } from "./protocol";

export interface Place {
  text: string;
  file: string;
  line: number;
}

export interface Part {
  text: string;
  value: number | boolean | string | null | Triple;
  unit: string;
  shown: string;
  role: string; // draw, bar, joined, or empty
  parts: Part[];
}

export interface Looked {
  place: Place;
  kind: string;
  target: string;
  condition: Part | null;
  held: boolean;
  timers: { what: string; has: number; needs: number; unit: string; holds: boolean }[];
  take: Part | null;
  fires: boolean;
  wins: boolean;
}

export interface Explanation {
  scene: string;
  species: string;
  agent: number;
  frame: number;
  hash: string;
  checkpoint: number;
  mode: string;
  strip: { machine: string; state: string; first: number; last: number }[]; // machine by machine, each in order of time
  alive: [number, number] | null;
  notes: string[];
  machines: {
    machine: string;
    before: string;
    after: string;
    since: number;
    looked: Looked[];
    changed: boolean;
    claim: {
      items: string;
      item: string;
      attribute: string;
      amount: number | null;
      draw: number;
      won: boolean;
      place: Place;
    } | null;
    choice: { draw: number; bars: [string, number][]; chosen: string } | null;
  }[];
  handlers: Place[];
  steers: { text: string; push: Triple; length: number }[];
  layers: {
    place: Place;
    state: string;
    condition: Part | null;
    left: number;
    push: Triple | null;
    length: number;
    given: Triple;
    share: number;
    cut: number;
  }[];
  push: Triple;
  velocity: [Triple, Triple | null];
  acceleration: Triple | null;
  seen: { asked: string; of: string; count: number; nearest: { name: string; distance: number; about: string }[] }[];
  fields: [string, number][];
  senses: { kind: string; name: string; text: string; shown: string; values: unknown[] }[];
  draws: { site: string; text: string; value: number }[];
  did: string[];
  changes: { name: string; shown: [string, string]; unit: string; memory: boolean }[];
}
