// Notes and edits: the messages about them, and the texts that name agents and places in their lines.

import type { Agent } from "./store";

/** Notes change the run, edits the frames that were simulated. */
export type List = "notes" | "edits";

/** A key of a verb, from the server's tables. */
export interface VerbKey {
  name: string;
  kind: string;
  unit: string;
  required: boolean;
  default: string;
  help: string;
  example: string;
  narrows: boolean; // whether it selects among the agents
  choices: string[];
}

export interface Verb {
  verb: string;
  help: string;
  keys: VerbKey[];
  kind: "agents" | "cache"; // of the verb's own value
  example: string;
  choices: string[];
}

/** A named line of the crowd. `ranges`: the first id and the number of ids of each range, in the order of its numbers. */
export interface CrowdLine {
  name: string;
  species: string;
  ranges: [number, number][];
}

export interface Verbs {
  op: "verbs";
  notes: Verb[];
  edits: Verb[];
  lines: CrowdLine[];
  origin: [number, number, number]; // of positions on pages, in mm
}

export interface Line {
  key: number;
  line: string;
  on: boolean;
  problem: string; // why it was switched off
}

/** The notes or edits that pages added, all of them. */
export interface Lines {
  op: List;
  lines: Line[];
  problem: string; // why the displayed frame lacks them
  file: string; // where to write them
  settling?: Settling; // of edits
}

/** The agents that edits affect, simulated again. */
export interface Settling {
  running: boolean;
  settled: boolean; // whether the displayed frames have such agents
  report: string[];
}

export interface LineProblem {
  key: string; // empty: about the whole line
  severity: "error" | "warning";
  message: string;
  help: string;
}

/** The answer to a draft of a line. */
export interface Directed {
  op: "directed";
  list: List;
  line: string;
  ok: boolean;
  applied: boolean;
  problems: LineProblem[];
  choices: Record<string, string[]>; // by key: values that fit the agents
}

/** A place that the user clicked: an item, an agent, or a point relative to the origin of positions (mm). */
export interface Place {
  item: string;
  agent: Agent | null;
  point: [number, number, number] | null;
}

const MOST_PARTS = 150; // names in a text; more agents need a condition

/** Return the shortest text that names these agents, such as `guards.3..9`; empty if it would be too long. */
export function nameAgents(agents: readonly Agent[], lines: readonly CrowdLine[]): string {
  const numbers = new Map<string, number[]>();
  for (const agent of agents) {
    const [name, number] = nameAgent(agent, lines);
    numbers.set(name, [...(numbers.get(name) ?? []), number]);
  }
  const parts: string[] = [];
  for (const [name, all] of numbers) {
    all.sort((a, b) => a - b);
    const line = lines.find((each) => each.name === name);
    if (line && all.length === line.ranges.reduce((sum, [, count]) => sum + count, 0)) parts.push(name);
    else parts.push(...ranges(all).map(([first, last]) => `${name}.${first}${last > first ? `..${last}` : ""}`));
  }
  if (parts.length > MOST_PARTS) return "";
  return parts.length > 1 ? `[${parts.join(", ")}]` : (parts[0] ?? "");
}

function nameAgent(agent: Agent, lines: readonly CrowdLine[]): [string, number] {
  for (const line of lines) {
    if (line.species !== agent.species) continue;
    let before = 0;
    for (const [first, count] of line.ranges) {
      if (agent.id >= first && agent.id < first + count) return [line.name, before + agent.id - first];
      before += count;
    }
  }
  return [agent.species, agent.id];
}

function ranges(numbers: readonly number[]): [number, number][] {
  const found: [number, number][] = [];
  for (const number of numbers) {
    const last = found.at(-1);
    if (last && number === last[1] + 1) last[1] = number;
    else found.push([number, number]);
  }
  return found;
}

/** Return a place as text in the units of the scene. */
export function namePlace(place: Place, verbs: Verbs, unitMm: number): string {
  if (place.item) return place.item;
  if (place.agent) return nameAgents([place.agent], verbs.lines);
  if (!place.point) return "";
  const digits = Math.max(0, Math.round(Math.log10(unitMm)) + 1); // tenths of a millimetre
  const parts = place.point.map((part, k) => Number(((part + (verbs.origin[k] as number)) / unitMm).toFixed(digits)) + 0);
  return `[${parts.join(", ")}]`;
}

/** Return the value of a key after the user clicked a place. */
export function putPlace(key: VerbKey, value: string, place: string): string {
  switch (key.kind) {
    case "looks":
      return `{${(/^\{\s*(\w+)\s*:/.exec(value) ?? /^\{\s*(\w+)/.exec(key.example))?.[1] ?? "head"}: ${place}}`;
    case "region":
      return `{around: ${place}, radius: ${/radius:\s*([^,}]+)/.exec(value)?.[1]?.trim() ?? "50 mm"}}`;
    case "path":
    case "points":
      return /^\[\s*\[.*\]\s*\]$/.test(value) ? `${value.replace(/\s*\]$/, "")}, ${place}]` : `[${place}]`;
    default:
      return place;
  }
}

/** The kinds of keys with a place that the user can click. `agents`: whether it may be an agent. `items`: or an item. */
export const PICKED: Record<string, { agents: boolean; items: boolean }> = {
  target: { agents: true, items: true },
  looks: { agents: true, items: true },
  region: { agents: false, items: true },
  path: { agents: false, items: false },
  points: { agents: false, items: false },
  place: { agents: false, items: true },
};
