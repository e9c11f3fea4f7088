// What goes over the wire. Text messages are JSON with an `op`; binary ones are a header and arrays, see `unpack`.
// The Python side is antdsl/preview/requests.py (what a page may ask) and antdsl/preview/viewing (what it is shown).
// Places are in mm of the world, less its origin; turns are unit vectors; colours are display values 0..1.

import type { Explanation } from "./explanation";

export type Triple = [number, number, number];

// --- what a page asks ----------------------------------------------------------------------------------------------

/** How many agents have their planned paths shown at most: of those who are named, and of all when nobody is. */
export const MOST_PLANNED = { chosen: 60, all: 300 };

export type Break =
  | { kind: "state"; species: string; machine: string; state: string }
  | { kind: "condition"; text: string } // in the language of specs, such as `count(state == carry) > 10`
  | { kind: "spec"; spec: string }
  | { kind: "fault" };

export type Ask =
  | { op: "play" }
  | { op: "pause" }
  | { op: "step"; count?: number }
  | { op: "speed"; times: number } // 1: as fast as the scene's clock; 0: as fast as it goes
  | { op: "seek"; frame: number; exact: boolean } // not exact: show what is remembered of it, simulate nothing
  | { op: "set"; name: string; value: string }
  | { op: "layer"; species: string; layer: string; on: boolean }
  | { op: "field"; name: string; on: boolean }
  | { op: "reload" }
  | { op: "restart" } // simulate it again from the first frame: a run that nobody edited on the way
  | {
      op: "look"; // what this page shows, all of it each time
      columns: { species: string; name: string }[];
      fields: string[];
      flows: string[];
      solids: boolean;
      follow: { species: string; agent: number } | null; // whose feelers are felt in each frame
      planned?: { species: string; agent: number }[]; // whose paths in the time to come; of nobody named those of all, if few
    }
  | { op: "explain"; species: string; agent: number; frame: number }
  | { op: "breaks"; breaks: Break[]; tried?: Break } // all there are; one more, which is added if it fits the program
  | { op: "profile"; on: boolean };

// --- what a page is told -------------------------------------------------------------------------------------------

export interface Hello {
  op: "hello";
  version: string;
  build: string; // of the page that the server has: another one than this page's means to load it again
  scene: string;
  token?: string; // to come back with, for a page that was let in without it
  key?: string; // proves to a server that is started again that this page was let in here
}

export interface Attribute {
  name: string;
  unit: string; // as authors write it; empty for a plain number
}

export interface Machine {
  name: string;
  states: string[];
  colours: Triple[];
}

export interface LayerInfo {
  text: string;
  file: string;
  line: number;
  on: boolean;
}

export interface Species {
  name: string;
  bodies: string[]; // the keys of its bodies, one or more
  attributes: Attribute[]; // numbers that agents can be coloured by
  machines: Machine[];
  layers: LayerInfo[];
  feelers: { count: number; spread: number; reach: number; per_length: number }[]; // radians, mm, body lengths
}

export interface Param {
  name: string; // qualified: forager.smell
  value: string; // as written now: `50 mm`
  number: number; // in `unit`
  unit: string;
  low: number | null;
  high: number | null;
  help: string;
  file: string;
  line: number;
  written: string; // the value that the files have
}

export interface ChartBox {
  key: string;
  kind: "state" | "start" | "any" | "previous" | "choice";
  name: string;
  label: string;
  colour: Triple;
  details: string;
  centre: [number, number];
  width: number;
  height: number;
}

export interface ChartArrow {
  source: string;
  target: string;
  lines: string[];
  interrupt: boolean;
  details: string;
  points: [number, number][];
  words: { centre: [number, number]; width: number; height: number } | null;
}

export interface Chart {
  species: string;
  machine: string;
  title: string;
  width: number;
  height: number;
  boxes: ChartBox[];
  arrows: ChartArrow[];
}

/** A pinhole on a sensor 36 mm wide, with its focal length in millimetres. */
export interface Camera {
  at: Triple;
  look_at: Triple;
  focal: number;
}

export interface Scene {
  op: "scene";
  name: string;
  fps: number;
  last: number; // the last frame that the scene asks for
  unit_mm: number;
  up: Triple;
  low: Triple; // of all ground and agents
  high: Triple;
  camera: Camera | null; // the scene's own, as it is in the first frame
  species: Species[];
  params: Param[];
  fields: { name: string; unit: string; colour: Triple; on: boolean; full: number }[]; // `full`: where its colours end at first
  flows: string[];
  curves: string[];
  solids: string[];
  items: { name: string; kind: string; names: string[]; amounts: (Attribute & { first: number[] })[] }[]; // what each had at first
  specs: string[];
  charts: Chart[];
  charts_need: string; // why there are no charts: what to install; empty where there are
}

export interface Status {
  op: "status";
  frame: number;
  first: number; // of what can be gone back to
  head: number; // the last one simulated
  playing: boolean;
  speed: number;
  rate: number; // frames simulated in a second, lately
  edited: boolean; // changed while it ran: not what a fresh run gives
  fault: string | null;
  paused_by: string | null; // the breakpoint that did it, in words
  paused_agents: { species: string; agents: number[] } | null; // whom it was about, by id; the first few
  hash: string | null; // of the whole state, while it stands still
  agents: number;
  transitions: Record<string, number>; // changes of state so far, by `SPECIES.FROM->TO`
  light: boolean; // what is shown is remembered, not simulated again: seek exactly to look closer
}

export interface Problem {
  code: string;
  severity: "error" | "warning";
  message: string;
  help: string;
  file: string | null;
  start: number; // offsets in UTF-16 units, as CodeMirror counts
  end: number;
  line: number;
  column: number;
}

export interface Problems {
  op: "problems";
  problems: Problem[]; // of the files as they are; the last good program runs on while there are errors
}

export interface Texts {
  op: "texts";
  texts: { file: string; text: string; kind: "ant" | "yaml" | "library" }[];
}

export interface Outcome {
  op: "outcome";
  of: string; // the op that it answers, or `saved`
  ok: boolean;
  did: string; // what was edited: a line of a file, a value, a switch
  line: string; // what was kept, moved and reset
  text: string; // what to write into a file to have the same for good
  file: string; // where it would stand; empty where nothing is to be written
  problems: Problem[];
}

export interface Curves {
  op: "curves";
  reset: boolean; // what one has is to be forgotten from `frames[0]` on, or altogether when there are none
  frames: number[];
  values: Record<string, (number | null)[]>; // by name, as specs call them: `forager.state.carry`; specs: `spec: NAME`, 1 or 0
  branches: { first: number; line: string; frames: number[]; values: Record<string, (number | null)[]> }[] | null;
}

export interface Profile {
  op: "profile";
  frames: number;
  total: number; // ms a frame
  phases: { name: string; ms: number }[];
  layers: { species: string; text: string; file: string; line: number; ms: number }[];
  lines: { file: string; line: number; text: string; ms: number }[];
}

export interface Explained {
  op: "explained";
  species: string;
  agent: number;
  frame: number;
  explanation: Explanation | null;
  told: string; // the same in words, as `antdsl explain` prints it
  message: string; // why there is none
  place: Triple | null; // where it stood as the step began
  neighbours: Triple[]; // where those stood that it looked at
}

export interface Specs {
  op: "specs"; // whenever one of them changes; their curves are `spec: NAME`
  specs: {
    name: string;
    holds: boolean | null; // so far; null: it is not judged here
    since: number | null; // the frame from which on it is judged: the first one, or that of the last edit
    frame: number | null; // where it failed
    message: string; // how it failed, or why it is not judged
    species: string; // whom a failure is about; empty where it is about the whole
    agents: number[];
  }[];
}

export interface BreaksSet {
  op: "breaks"; // all breakpoints that there are, whoever set them
  breaks: { made: Break; why: string }[]; // `why` it does not fit the program, which it waits for; empty where it does
}

export interface Stops {
  op: "stops"; // the frames at which play was stopped by itself, and why; all of them each time
  stops: { frame: number; line: string }[];
}

/** Asks a page with an old token to prove that it was let in before: see connection.ts. Comes before anything else. */
export interface Return {
  op: "return";
  nonce: string;
}

export interface Refused {
  op: "refused";
  of: string;
  message: string;
  help: string;
}

export type Told =
  | Hello
  | Scene
  | Status
  | Problems
  | Texts
  | Outcome
  | Curves
  | Specs
  | BreaksSet
  | Stops
  | Return
  | Profile
  | Explained
  | Refused;

// --- arrays --------------------------------------------------------------------------------------------------------

// A binary message: 4 bytes `ant1`, uint32 length of the header, the header as JSON, then the arrays, each at a multiple of
// 8 bytes from the message's start. Little-endian throughout. A packet replaces the one before of the same `slot`.
//
// slot            arrays
// frame           NAME/id i32[n] NAME/position f32[n,3] NAME/heading i8[n,3] NAME/up i8[n,3] NAME/size f32[n] NAME/speed f32[n]
//                 NAME/born i32[n] NAME/state/MACHINE u8[n] NAME/column/ATTRIBUTE f32[n];
//                 NAME/plays/MACHINE u16[n,3,2 or 3]: clip and those before, how far through, what each weighs; 65535 is none, 1;
//                 NAME/wears u32[n] NAME/look/GROUP i8[n,3] NAME/lean i8[n,3];
//                 NAME/feet i16[n,l,3] NAME/stance i16[n,6]: see feet.ts;
//                 of a species with several bodies NAME/body u8[n]; its plays, wears, look, lean, traits, feet and stance are
//                 KEY/… for the agents of each body;
//                 item/NAME/position f32[m,3] item/NAME/size f32[m] item/NAME/amount/ATTRIBUTE f32[m];
//                 feelers f32[k,2,3] feelers/hit u8[k] of those who are followed; rows by id. header: frame, light,
//                 felt (whose feelers: lists of species, agent and how many, one after the other).
//                 A light one has id, position, heading, up, size and state alone. Turns: 127 is 1
// paths           NAME/id i32[n] NAME/path f32[n,count,3]: where agents will be, from `frame` of the header on, nan where one is not
//                 there; header: frame, count
// mesh:NAME       position f32[n,3] face u32[m,3]; header: role `ground`, `obstacle`; moves: comes each frame
// rig:KEY         sample f32[r,j,texels,4] parent i32[j] clip i32[p,3,4] group f32[g,j] leg f32[l,2,4] look f32[k,j]: what is played, see rig.ts;
//                 LEVEL/position f32[n,3] LEVEL/normal i8[n,3] LEVEL/face u32[m,3] LEVEL/colour u8[n,4] (linear, as roots; how
//                 much of the agent's own) LEVEL/bone u16[n,4] LEVEL/weight f32[n,4] LEVEL/joint i32[b] LEVEL/part i32[b]
//                 LEVEL/inverse f32[b,3,4], LEVEL `low` and `fine`; header: machines, joints, texels, base, length, idle, looks, leans, bending
// item:KIND:NAME  position f32[n,3] face u32[m,3] colour f32[n,3]: an item's mesh, radius 1, up +y; header: items (name), index, shape
// fieldmesh:NAME  position f32[n,3] face u32[m,3]: before the first `field`, and where ground was dug or has moved
// field:NAME      value u8[n]: 0 nothing, 1 is 1e-8 and 255 is 1e8, in even steps of their powers of ten
// flow:NAME       from f32[n,3] way f32[n,3]
// curve:NAME      point f32[n,3]; header: closed
// solid:NAME:N    position f32[n,3] normal f32[n,3] face u32[m,3]; an empty one takes a piece away
export interface Packet {
  slot: string;
  header: Record<string, unknown> & {
    slot: string;
    frame?: number;
    count?: number;
    light?: boolean;
    felt?: [string, number, number][];
  };
  arrays: Map<string, NumberArray>;
}

export type NumberArray = Float32Array | Int32Array | Uint32Array | Uint8Array | Int8Array | Uint16Array | Int16Array;

const TYPES = {
  f4: Float32Array,
  i4: Int32Array,
  u4: Uint32Array,
  u1: Uint8Array,
  i1: Int8Array,
  u2: Uint16Array,
  i2: Int16Array,
};

export function unpack(data: ArrayBuffer): Packet {
  const view = new DataView(data);
  if (data.byteLength < 8 || view.getUint32(0) !== 0x616e7431) throw new Error("not a packet");
  const length = view.getUint32(4, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 8, length)));
  const arrays = new Map<string, NumberArray>();
  for (const [name, type, count, offset] of header.arrays as [string, keyof typeof TYPES, number, number][]) {
    arrays.set(name, new TYPES[type](data, offset, count));
  }
  return { slot: header.slot, header, arrays };
}
