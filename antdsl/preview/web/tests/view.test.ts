import * as THREE from "three";
import { describe, expect, test } from "vitest";
import type { Explanation } from "../src/explanation";
import { keyRows } from "../src/view/acts/forces";
import { tally } from "../src/view/acts/legend";
import { planned, unseen } from "../src/view/acts/paths";
import { missing } from "../src/view/acts/trails";
import { NATURAL } from "../src/store";
import { machineOf, numbersOf, paint, paintFromBodies, ranged } from "../src/view/herds/colours";
import { Herd } from "../src/view/herds/herd";
import { partOf } from "../src/view/herds/herds";
import { arranged } from "../src/view/labels";
import { RAMP } from "../src/view/palette";
import { fullOf, level, SHOWN } from "../src/view/scales";
import { left } from "../src/view/scenery/items";
import { acts, frame, herd, MACHINE, scene, species, wired } from "./made";

describe("the scale of a field", () => {
  test("is by powers of ten, full at its end and empty SHOWN powers below", () => {
    expect(level(100, 100)).toBe(1);
    expect(level(10, 100)).toBeCloseTo(1 - 1 / SHOWN);
    expect(level(100 / 10 ** SHOWN, 100)).toBeCloseTo(0);
    expect(level(1e9, 100)).toBe(1);
    expect(level(1e-9, 100)).toBe(0);
    expect(level(0, 100)).toBe(0);
  });

  test("ends where somebody chose, else where the server proposes, else at 100", () => {
    const { store } = wired();
    expect(fullOf(store.now, "scent")).toBe(100);
    store.set("scene", scene({ fields: [{ name: "scent", unit: "", colour: [1, 1, 1], on: true, full: 7 }] }));
    expect(fullOf(store.now, "scent")).toBe(7);
    store.set("full", { scent: 3 });
    expect(fullOf(store.now, "scent")).toBe(3);
  });
});

describe("the ramp of numbers", () => {
  /** How light an entry is seen: the first of the three numbers of Oklab. */
  const light = (entry: number) => {
    const [r = 0, g = 0, b = 0] = [...RAMP.subarray(3 * entry, 3 * entry + 3)].map((byte) => {
      const part = byte / 255;
      return part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4;
    });
    const l = Math.cbrt(0.4122214708 * r + 0.5363325363 * g + 0.0514459929 * b);
    const m = Math.cbrt(0.2119034982 * r + 0.6806995451 * g + 0.1073969566 * b);
    const s = Math.cbrt(0.0883024619 * r + 0.2817188376 * g + 0.6299787005 * b);
    return 0.2104542553 * l + 0.793617785 * m - 0.0040720468 * s;
  };

  test("goes from violet to yellow", () => {
    const [r = 0, g = 0, b = 0] = RAMP.subarray(0, 3);
    expect(b).toBeGreaterThan(r);
    expect(r).toBeGreaterThan(g);
    const [red = 0, green = 0, blue = 0] = RAMP.subarray(3 * 255);
    expect(Math.min(red, green)).toBeGreaterThan(blue + 50);
  });

  test("grows lighter everywhere, in steps about even", () => {
    const steps = Array.from({ length: 15 }, (_, k) => light(17 * (k + 1)) - light(17 * k));
    const mean = (light(255) - light(0)) / steps.length;
    expect(mean).toBeCloseTo(0.48 / 15, 2);
    expect(Math.min(...steps)).toBeGreaterThan(0.6 * mean); // screens do not have all of its colours
    expect(Math.max(...steps)).toBeLessThan(1.5 * mean);
  });
});

describe("the colour of agents", () => {
  const ants = species({ attributes: [{ name: "load", unit: "mg" }] });
  const three = frame([1, 2, 3], new Array<number>(9).fill(0), {
    "state/main": Uint8Array.of(1, 0, 9),
    "column/load": Float32Array.of(0, 5, 20),
    speed: Float32Array.of(1, 2, 3),
  });
  const tones = (of: ReturnType<typeof herd>) => [0, 1, 2].map((row) => [...of.rows.tone.subarray(4 * row, 4 * row + 4)]);

  test("goes by the first machine, by one that is named, or by none", () => {
    const two = species({ machines: [MACHINE, { ...MACHINE, name: "mood" }] });
    expect(machineOf(two, "state")?.name).toBe("main");
    expect(machineOf(two, "state/mood")?.name).toBe("mood");
    expect(machineOf(two, "state/none")).toBeUndefined();
    expect(machineOf(two, "speed")).toBeUndefined();
  });

  test("is that of the state; a state that the program does not have is plain", () => {
    const made = herd(three, ants);
    paint(made, "state", null);
    expect(tones(made)).toEqual([
      [0, 128, 255, 255],
      [255, 0, 0, 255],
      [158, 153, 145, 255],
    ]);
  });

  test("is at first the natural one of the body; an edit overrides it", () => {
    expect(wired().store.now.colour).toBe(NATURAL);
    const made = herd(frame([1, 2], new Array<number>(6).fill(0), { tint: Uint8Array.of(0, 0, 0, 0, 1, 2, 3, 1) }), ants);
    paint(made, NATURAL, null);
    expect([...made.rows.tone.subarray(0, 4)]).toEqual([158, 153, 145, 255]); // before the body is known
    made.acting(acts());
    paint(made, NATURAL, null);
    expect([...made.rows.tone.subarray(0, 8)]).toEqual([90, 60, 30, 255, 1, 2, 3, 255]);
  });

  test("varies by the trait that selects the natural colour", () => {
    const traits = { "trait/0": new Float32Array(9), "trait/1": Float32Array.of(0, 0, 9, 0.5, 9, 9, 2, 9, 9) };
    const made = herd(frame([1, 2, 3], new Array<number>(9).fill(0), traits), ants);
    const table = Uint8Array.from({ length: 15 }, (_, k) => 10 * k);
    made.acting(acts({ traits: 4, natural: { table, trait: 3, steps: 2 } }));
    paint(made, NATURAL, null);
    expect(tones(made)).toEqual([
      [0, 10, 20, 255],
      [30, 40, 50, 255],
      [120, 130, 140, 255],
    ]);
  });

  test("of a species with several bodies is that of each agent's body", () => {
    const all = frame([1, 2, 5], new Array<number>(9).fill(0), { body: Uint8Array.of(1, 0, 1) });
    const two = species({ bodies: ["ant#0", "ant#1"] });
    const parts = two.bodies.map((key, body) => {
      const part = new Herd(two, key);
      part.take(partOf(all, "ant", body), 1, true);
      part.acting(acts(body ? {} : { natural: { table: Uint8Array.of(1, 2, 3), trait: -1, steps: 0 } }));
      paint(part, NATURAL, null);
      return part;
    });
    const made = herd(all, two);
    paintFromBodies(made, parts);
    expect(tones(made)).toEqual([
      [90, 60, 30, 255],
      [1, 2, 3, 255],
      [90, 60, 30, 255],
    ]);
  });

  test("goes by numbers along the ramp, and stays at its ends beyond them", () => {
    const made = herd(three, ants);
    paint(made, "load", { low: 0, high: 10, unit: "mg" });
    expect(tones(made)).toEqual([
      [...RAMP.subarray(0, 3), 255],
      [...RAMP.subarray(3 * 128, 3 * 129), 255],
      [...RAMP.subarray(3 * 255), 255],
    ]);
  });

  test("goes by numbers that the species has, in their unit", () => {
    const made = herd(three, ants);
    expect(numbersOf(made, "load")?.unit).toBe("mg");
    expect(numbersOf(made, "speed")?.unit).toBe("mm/s");
    expect(numbersOf(made, "age")).toBeUndefined();
  });

  test("has a ramp that begins at zero where that is near, and ends on a round number", () => {
    expect(ranged([herd(three, ants)], "load", null)).toEqual({ low: 0, high: 20, unit: "mg" });
    expect(ranged([herd(three, ants)], "speed", null)).toEqual({ low: 0, high: 3, unit: "mm/s" });
  });

  test("keeps its ramp while most of it is in use, and its last one when nobody has such a number", () => {
    const wide = { low: 0, high: 40, unit: "mg" };
    expect(ranged([herd(three, ants)], "load", wide)).toBe(wide);
    expect(ranged([herd(three, ants)], "load", { ...wide, high: 400 })).toEqual({ low: 0, high: 20, unit: "mg" });
    expect(ranged([herd(three, ants)], "load", { ...wide, unit: "g" })?.unit).toBe("mg");
    expect(ranged([herd(three, ants)], "age", wide)).toBe(wide);
  });

  test("is counted state by state", () => {
    expect(tally(herd(three, ants), MACHINE)).toEqual([1, 1]);
    expect(tally(herd(frame([1], [0, 0, 0])), MACHINE)).toEqual([0, 0]);
  });
});

describe("what is left of an item", () => {
  const sugar = { name: "sugar", unit: "mg", first: [0, 80] };

  test("is a part of what it had, and words with its unit", () => {
    expect(left([sugar], 1, () => 20)).toEqual([0.25, "20 mg sugar"]);
    expect(left([sugar], 1, () => 1234.567)).toEqual([1, "1,235 mg sugar"]);
  });

  test("is all of what had nothing at first", () => {
    expect(left([sugar], 0, () => 12)).toEqual([1, "12 mg sugar"]);
    expect(left([], 0, () => 12)).toEqual([1, ""]);
  });

  test("goes by the first amount that there was, and names them all", () => {
    const seeds = { name: "seeds", unit: "", first: [10, 10] };
    const now = new Map([
      ["sugar", 5],
      ["seeds", 5],
    ]);
    expect(left([sugar, seeds], 0, (name) => now.get(name))).toEqual([0.5, "5 mg sugar · 5 seeds"]);
    expect(left([sugar, seeds], 1, () => undefined)).toEqual([1, ""]);
  });
});

test("missing trails say why", () => {
  expect(missing(1, 5000, 10)).toBe("");
  expect(missing(0, 5000, 0)).toContain("5,000 are too many at once");
  expect(missing(61, 5000, 10)).toBe("trails of the last 60 of 61 that are selected");
  expect(missing(0, 300, 0)).toBe("no trails yet: they grow as it plays");
});

describe("the key of the arrows", () => {
  const colours = { ink: new THREE.Color("#102030"), mark: new THREE.Color("#405060") };
  const layer = (more: Partial<Explanation["layers"][number]>): Explanation["layers"][number] => ({
    place: { text: "turn", file: "", line: 1 },
    state: "pushed",
    condition: null,
    left: 1,
    push: [1, 0, 0],
    length: 1,
    given: [1, 0, 0],
    share: 1,
    cut: 0,
    ...more,
  });

  test("has those layers that pushed, each in the colour of its place, and what came of them", () => {
    const layers = [layer({}), layer({ push: null }), layer({ place: { text: "flee", file: "", line: 2 }, cut: 0.5 })];
    const rows = keyRows(layers, colours);
    expect(rows.map(([, words, cut]) => [words, cut])).toEqual([
      ["turn", false],
      ["flee", true],
      ["all layers together", false],
      ["velocity, after", false],
    ]);
    expect(keyRows([layers[2] as (typeof layers)[number]], colours)[0]?.[0]).not.toBe(rows[1]?.[0]);
    expect(rows.slice(2).map(([colour]) => colour)).toEqual(["#102030", "#405060"]);
  });

  test("is empty where nobody pushed", () => {
    expect(keyRows([layer({ push: null }), layer({ length: 0 })], colours)).toEqual([]);
  });
});

describe("planned paths", () => {
  test("are read species by species from a packet", () => {
    const arrays = new Map<string, Int32Array | Float32Array>([
      ["ant/id", new Int32Array([3, 9])],
      ["ant/path", new Float32Array(2 * 4 * 3)],
    ]);
    const found = [...planned({ slot: "paths", header: { slot: "paths", frame: 7, count: 4 }, arrays })];
    expect(found.map(([name, ids, places, count]) => [name, [...ids], places.length, count])).toEqual([["ant", [3, 9], 24, 4]]);
  });

  test("say why they are not seen", () => {
    expect(unseen(0, 301, 0)).toContain("301 are too many");
    expect(unseen(61, 400, 9)).toContain("the last 60 of 61");
    expect(unseen(1, 400, 0)).toBe("planned paths: being simulated");
    expect(unseen(1, 400, 5)).toBe("");
    expect(unseen(0, 300, 5)).toBe("");
  });
});

describe("labels", () => {
  const wish = (x: number, y: number, far: number, wide: [number, number] = [100, 30]) => ({ x, y, far, wide, high: 16 });

  test("stand above their places, and within the view", () => {
    expect(arranged([wish(200, 50, 1)], 400)).toEqual([{ left: 150, top: 34, whole: true }]);
    expect(arranged([wish(10, 50, 1), wish(390, 90, 1)], 400)).toMatchObject([{ left: 4 }, { left: 296 }]);
  });

  test("leave out what they hold where they would lie over a nearer one, and are left out where that does not help", () => {
    const spots = arranged([wish(270, 50, 3), wish(200, 50, 1), wish(205, 52, 2)], 400);
    expect(spots).toEqual([{ left: 255, top: 34, whole: false }, { left: 150, top: 34, whole: true }, null]);
  });
});
