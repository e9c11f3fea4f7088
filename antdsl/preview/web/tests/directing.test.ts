// Texts of notes: which agents they name, and where a click is.

import { describe, expect, it } from "vitest";
import { type CrowdLine, nameAgents, namePlace, putPlace, type VerbKey, type Verbs } from "../src/directing";

const lines: CrowdLine[] = [
  {
    name: "guards",
    species: "ant",
    ranges: [
      [10, 3],
      [20, 2],
    ],
  },
  { name: "queen", species: "ant", ranges: [[40, 1]] },
];
const ants = (...ids: number[]) => ids.map((id) => ({ species: "ant", id }));
const verbs = { lines, origin: [100, 0, 0] } as unknown as Verbs;
const key = (kind: string, example = "") => ({ kind, example }) as VerbKey;

describe("names of agents", () => {
  it("are numbers of their crowd line, else ids", () => {
    expect(nameAgents(ants(20), lines)).toBe("guards.3");
    expect(nameAgents(ants(3), lines)).toBe("ant.3");
    expect(nameAgents([], lines)).toBe("");
  });
  it("are ranges and lists, and the line itself if it is complete", () => {
    expect(nameAgents(ants(12, 11, 10), lines)).toBe("guards.0..2");
    expect(nameAgents(ants(11, 21, 40, 5, 6, 7, 9), lines)).toBe("[guards.1, guards.4, queen, ant.5..7, ant.9]");
    expect(nameAgents(ants(10, 11, 12, 20, 21), lines)).toBe("guards");
  });
  it("are empty if the text would be too long", () => {
    expect(nameAgents(ants(...Array.from({ length: 400 }, (_, k) => 100 + 2 * k)), lines)).toBe("");
  });
});

describe("places", () => {
  it("are in the units of the scene, from its zero point", () => {
    const point: [number, number, number] = [-100.04, 12.34, -0.01];
    expect(namePlace({ item: "", agent: null, point }, verbs, 1)).toBe("[0, 12.3, 0]");
    expect(namePlace({ item: "", agent: null, point }, verbs, 1000)).toBe("[0, 0.0123, 0]");
    expect(namePlace({ item: "leaf", agent: null, point: null }, verbs, 1)).toBe("leaf");
    expect(namePlace({ item: "", agent: { species: "ant", id: 40 }, point: null }, verbs, 1)).toBe("queen");
  });
  it("fill in the value of their kind, and keep its other parts", () => {
    expect(putPlace(key("target"), "old", "leaf")).toBe("leaf");
    expect(putPlace(key("looks", "{head: leaf}"), "", "[1, 2, 3]")).toBe("{head: [1, 2, 3]}");
    expect(putPlace(key("looks", "{head: leaf}"), "{neck: leaf}", "stone")).toBe("{neck: stone}");
    expect(putPlace(key("region"), "{around: leaf, radius: 8 mm}", "[0, 0, 0]")).toBe("{around: [0, 0, 0], radius: 8 mm}");
    expect(putPlace(key("path"), "", "[0, 0, 0]")).toBe("[[0, 0, 0]]");
    expect(putPlace(key("path"), "[[0, 0, 0]]", "[5, 0, 0]")).toBe("[[0, 0, 0], [5, 0, 0]]");
    expect(putPlace(key("path"), "way", "[5, 0, 0]")).toBe("[[5, 0, 0]]");
  });
});
