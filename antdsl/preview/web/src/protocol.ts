// The messages between page and server. Text messages are JSON with an `op`; binary ones are a header and arrays, see `unpack`.
// The Python side: antdsl/preview/requests.py (requests of the page) and antdsl/preview/viewing (messages to the page).
// Positions are in mm, relative to the origin of the world; directions are unit vectors; colours are display values 0..1.

import type { Directed, Lines, List, Verbs } from "./directing";
import type { Explanation } from "./explanation";

export type Triple = [number, number, number];

// --- requests of the page --------------------------------------------------------------------------------------------

/** Maximum number of agents with planned paths: of the named agents, and of all agents if none is named. */
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
  | { op: "speed"; times: number } // 1: real time; 0: as fast as possible
  | { op: "seek"; frame: number; exact: boolean } // not exact: display the stored data and simulate nothing
  | { op: "set"; name: string; value: string }
  | { op: "layer"; species: string; layer: string; on: boolean }
  | { op: "field"; name: string; on: boolean }
  | { op: "direct"; list: List; verb: string; agents: string; values: Record<string, string>; apply: boolean } // checked, or applied
  | { op: "line"; list: List; key: number; action: "on" | "off" | "remove" }
  | { op: "settle"; on: boolean } // simulate agents again that edits affect; or stop, and remove the result
  | { op: "reload" }
  | { op: "restart" } // simulate the files again from the first frame, without edits during the run
  | {
      op: "look"; // what this page displays, complete in each message
      columns: { species: string; name: string }[];
      fields: string[];
      flows: string[];
      solids: boolean;
      follow: { species: string; agent: number } | null; // the agent with feelers in each frame
      planned?: { species: string; agent: number }[]; // agents with planned paths; if empty, all agents, unless they are too many
    }
  | { op: "explain"; species: string; agent: number; frame: number }
  | { op: "breaks"; breaks: Break[]; tried?: Break } // all breakpoints; `tried` is added if it fits the program
  | { op: "profile"; on: boolean };

// --- messages of the server ------------------------------------------------------------------------------------------

export interface Hello {
  op: "hello";
  version: string;
  build: string; // build number of the server's page; a page with another number reloads
  scene: string;
  token?: string; // for reconnections, if the page has none yet
  key?: string; // with it the page proves to a restarted server that it had access before
}

export interface Attribute {
  name: string;
  unit: string; // as authors write it; empty for plain numbers
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
  bodies: string[]; // keys of its bodies, at least one
  attributes: Attribute[]; // numeric attributes, for colouring
  machines: Machine[];
  layers: LayerInfo[];
  feelers: { count: number; spread: number; reach: number; per_length: number }[]; // radians, mm, body lengths
}

export interface Param {
  name: string; // qualified: forager.smell
  value: string; // as written now: `50 mm`
  number: number; // the current value as text: `50 mm`
  unit: string;
  low: number | null;
  high: number | null;
  help: string;
  file: string;
  line: number;
  written: string; // the value in the files
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
  last: number; // the last frame of the scene
  unit_mm: number;
  up: Triple;
  low: Triple; // bounds of ground and agents
  high: Triple;
  camera: Camera | null; // the scene's camera in the first frame
  species: Species[];
  params: Param[];
  fields: { name: string; unit: string; colour: Triple; on: boolean; full: number }[]; // `full`: the initial value of full colour
  flows: string[];
  curves: string[];
  solids: string[];
  items: { name: string; kind: string; names: string[]; amounts: (Attribute & { first: number[] })[] }[]; // initial amounts
  specs: string[];
  charts: Chart[];
  charts_need: string; // why there are no charts (what to install); empty if there are charts
}

export interface Status {
  op: "status";
  frame: number;
  first: number; // the first available frame
  head: number; // the last simulated frame
  playing: boolean;
  speed: number;
  rate: number; // frames simulated per second, lately
  edited: boolean; // changed during the run: differs from a fresh run
  fault: string | null;
  paused_by: string | null; // the breakpoint, as text
  paused_agents: { species: string; agents: number[] } | null; // the agents that caused the stop, by id; only the first few
  hash: string | null; // of the whole state; null while it plays
  agents: number;
  transitions: Record<string, number>; // number of transitions so far, by `SPECIES.FROM->TO`
  light: boolean; // whether stored data is displayed; an exact seek simulates it again
}

export interface Problem {
  code: string;
  severity: "error" | "warning";
  message: string;
  help: string;
  file: string | null;
  start: number; // offsets in UTF-16 units, as in CodeMirror
  end: number;
  line: number;
  column: number;
}

export interface Problems {
  op: "problems";
  problems: Problem[]; // of the current files; while there are errors, the last good program continues
}

export interface Texts {
  op: "texts";
  texts: { file: string; text: string; kind: "ant" | "yaml" | "library" }[];
}

export interface Outcome {
  op: "outcome";
  of: string; // the `op` that it answers, or `saved`
  ok: boolean;
  did: string; // what was edited: a line of a file, a value, a switch
  line: string; // what was preserved, moved and reset
  text: string; // text to write into a file for the same effect
  file: string; // the file for `text`; empty if there is nothing to write
  problems: Problem[];
}

export interface Curves {
  op: "curves";
  reset: boolean; // forget the data from `frames[0]` on, or all data if there are no frames
  frames: number[];
  values: Record<string, (number | null)[]>; // by name, as in specs: `forager.state.carry`; specs: `spec: NAME`, 1 or 0
  branches: { first: number; line: string; frames: number[]; values: Record<string, (number | null)[]> }[] | null;
}

export interface Profile {
  op: "profile";
  frames: number;
  total: number; // ms per frame
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
  told: string; // the explanation as text, as `antdsl explain` prints it
  message: string; // why there is no explanation
  place: Triple | null; // position at the start of the step
  neighbours: Triple[]; // positions of the neighbours that it observed
}

export interface Specs {
  op: "specs"; // sent when a spec changes; the curves of specs are `spec: NAME`
  specs: {
    name: string;
    holds: boolean | null; // up to now; null: not checked here
    since: number | null; // the first frame that is checked: the first of the run, or that of the last edit
    frame: number | null; // the frame of the failure
    message: string; // how it failed, or why it is not checked
    species: string; // species of the failing agents; empty if the failure is about the whole run
    agents: number[];
  }[];
}

export interface BreaksSet {
  op: "breaks"; // all breakpoints, of all pages
  breaks: { made: Break; why: string }[]; // `why` it does not fit the program; empty if it fits
}

export interface Stops {
  op: "stops"; // all frames at which play stopped by itself, with the reason
  stops: { frame: number; line: string }[];
}

/** Requests a proof of earlier access from a page with an old token: see connection.ts. It precedes all other messages. */
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

export type ServerMessage =
  | Hello
  | Scene
  | Verbs
  | Lines
  | Directed
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
// 8 bytes from the start of the message. All little-endian. A packet replaces the previous one with the same `slot`.
//
// slot            arrays
// frame           NAME/id i32[n] NAME/position f32[n,3] NAME/heading i8[n,3] NAME/up i8[n,3] NAME/size f32[n] NAME/speed f32[n]
//                 NAME/born i32[n] NAME/state/MACHINE u8[n] NAME/column/ATTRIBUTE f32[n];
//                 NAME/plays/MACHINE u16[n,3,2 or 3]: clip and those before, how far through, what each weighs; 65535 is none, 1;
//                 NAME/wears u32[n] NAME/look/GROUP i8[n,3] NAME/lean i8[n,3];
//                 NAME/feet i16[n,l,3] NAME/stance i16[n,6] NAME/sole i16[n,l,3]: see feet.ts;
//                 of a species with several bodies NAME/body u8[n]; its plays, wears, look, lean, traits, feet and stance are
//                 KEY/… for the agents of each body;
//                 with edits NAME/tint u8[n,4]: a colour, and 1 for agents that have it;
//                 item/NAME/position f32[m,3] item/NAME/size f32[m] item/NAME/amount/ATTRIBUTE f32[m];
// feelers f32[k,2,3] feelers/hit u8[k] of the followed agents; rows by id. header: frame, light,
// felt (the agents of the feelers: triples of species, agent and number of feelers).
// A light frame has only id, position, heading, up, size and state. In directions, 127 is 1
// paths           NAME/id i32[n] NAME/path f32[n,count,3]: where agents will be, from `frame` of the header on, nan where one is not
//                 there; header: frame, count
// mesh:NAME       position f32[n,3] face u32[m,3]; header: role `ground`, `obstacle`; moves: comes each frame
// rig:KEY         sample f32[r,j,texels,4] parent i32[j] clip i32[p,3,4] group f32[g,j] leg f32[l,2,4] look f32[k,j]: what is played, see rig.ts;
//                 LEVEL/position f32[n,3] LEVEL/normal i8[n,3] LEVEL/face u32[m,3] LEVEL/colour u8[n,4] (linear, as roots; how
//                 much of the agent's own) LEVEL/bone u16[n,4] LEVEL/weight f32[n,4] LEVEL/joint i32[b] LEVEL/part i32[b]
//                 LEVEL/inverse f32[b,3,4], LEVEL `low` and `fine`; header: machines, joints, texels, base, length, idle, looks, leans, bending;
//                 natural u8[c,3]: the natural colour, or those along the path of its variation; header natural: [trait, steps per
//                 unit of it], empty without variation
// item:KIND:NAME  position f32[n,3] face u32[m,3] colour f32[n,3]: an item's mesh, radius 1, up +y; header: items (name), index, shape,
//                 look and roughness if the scene gives a look
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
