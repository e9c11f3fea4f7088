// Names and colours of curves: states have their own colours, other curves use a list of colours in turn.

import type { Scene } from "../../protocol";
import { css } from "../dom";

export type Group = "states" | "counts" | "specs";
export interface Named {
  name: string;
  words: string;
  colour: string;
  group: Group;
}

const TURN = ["#4aa3f0", "#f0a04a", "#7fcf6b", "#d67fe0", "#e06a6a", "#5fd0c8", "#cdbb4f", "#a58af5"];
const SPEC = "spec: ";

/** Return the label, colour and group of a curve, by the server's name for it. */
export function named(name: string, scene: Scene | null, order: number): Named {
  const turn = TURN[order % TURN.length] as string;
  if (name.startsWith(SPEC)) return { name, words: name.slice(SPEC.length), colour: turn, group: "specs" };
  const [kind = "", machine = "", state = ""] = name.split(".");
  const species = scene?.species.find((each) => each.name === kind);
  if (!species || !state) return { name, words: name, colour: turn, group: "counts" };
  const found = species.machines.find((each) => each.name === machine) ?? species.machines[0];
  const colour = found?.colours[found.states.indexOf(state)];
  const several = (scene?.species.length ?? 0) > 1;
  const words = [several && kind, species.machines.length > 1 && machine, state].filter(Boolean).join(" ");
  return { name, words, colour: colour ? css(colour) : turn, group: "states" };
}
