import { beforeEach, describe, expect, test } from "vitest";
import { Chosen } from "../src/panels/time/chooser";
import { CurveData, nearest } from "../src/panels/time/data";
import { named } from "../src/panels/time/naming";
import type { Curves } from "../src/protocol";
import { MACHINE, scene, species, wired } from "./made";

function curves(frames: number[], values: Curves["values"], more: Partial<Curves> = {}): Curves {
  return { op: "curves", reset: false, frames, values, branches: null, ...more };
}

test("the nearest frame is the last one that is not after", () => {
  const frames = [2, 4, 8];
  expect([1, 2, 3, 4, 7, 8, 99].map((frame) => nearest(frames, frame))).toEqual([-1, 0, 0, 1, 1, 2, 2]);
  expect(nearest([], 5)).toBe(-1);
});

describe("curves", () => {
  let data: CurveData;
  beforeEach(() => {
    data = new CurveData();
    data.take(curves([1, 2], { a: [10, 20] }));
  });

  test("grow by the frames that come", () => {
    data.take(curves([3], { a: [30] }));
    expect(data.now.frames).toEqual([1, 2, 3]);
    expect(data.now.values.get("a")).toEqual([10, 20, 30]);
    expect(data.changes).toBe(2);
  });

  test("have no value before the first and after the last message about them", () => {
    data.take(curves([3], { b: [5] }));
    expect(data.now.values.get("a")).toEqual([10, 20, null]);
    expect(data.now.values.get("b")).toEqual([null, null, 5]);
    expect(data.names).toEqual(["a", "b"]);
  });

  test("take a new value of a frame, and keep the other values there", () => {
    data.take(curves([3], { b: [5] }));
    data.take(curves([2], { a: [21] }));
    expect(data.now.frames).toEqual([1, 2, 3]);
    expect(data.now.values.get("a")).toEqual([10, 21, null]);
    expect(data.now.values.get("b")).toEqual([null, null, 5]);
  });

  test("pass over a frame that lies before all that is kept", () => {
    data.take(curves([0], { a: [1] }));
    expect(data.now.frames).toEqual([1, 2]);
    expect(data.now.values.get("a")).toEqual([10, 20]);
  });

  test("are forgotten from the first frame of a reset on", () => {
    data.take(curves([2, 3], { a: [7, 8] }, { reset: true }));
    expect(data.now.frames).toEqual([1, 2, 3]);
    expect(data.now.values.get("a")).toEqual([10, 7, 8]);
  });

  test("are forgotten altogether, with their names, by a reset without frames", () => {
    data.take(curves([], {}, { reset: true }));
    expect(data.now.frames).toEqual([]);
    expect(data.names).toEqual([]);
  });

  test("return the value at a frame, or the last one before", () => {
    expect(data.valueAt("a", 2)).toBe(20);
    expect(data.valueAt("a", 50)).toBe(20);
    expect(data.valueAt("a", 0)).toBeNull();
    expect(data.valueAt("b", 2)).toBeNull();
  });

  test("keep the abandoned branches until the next message about branches", () => {
    data.take(curves([], {}, { branches: [{ first: 2, line: "smell 3", frames: [2], values: { a: [9] } }] }));
    data.take(curves([3], { a: [1] }));
    expect(data.branches).toHaveLength(1);
    expect(data.branches[0]?.values.get("a")).toEqual([9]);
    data.take(curves([], {}, { branches: [] }));
    expect(data.branches).toEqual([]);
  });
});

describe("a curve's name", () => {
  test("of a state is that state, in its colour", () => {
    expect(named("ant.main.carry", scene(), 0)).toEqual({
      name: "ant.main.carry",
      words: "carry",
      colour: "rgb(0 128 255)",
      group: "states",
    });
  });

  test("says the machine and the species where there are several", () => {
    const two = scene({ species: [species({ machines: [MACHINE, { ...MACHINE, name: "mood" }] }), species({ name: "fly" })] });
    expect(named("ant.mood.carry", two, 0).words).toBe("ant mood carry");
    expect(named("fly.main.carry", two, 0).words).toBe("fly carry");
  });

  test("of anything else is itself, with a colour in turn", () => {
    const counts = [0, 1, 8].map((order) => named("food.amount", scene(), order));
    expect(counts.map((each) => each.group)).toEqual(["counts", "counts", "counts"]);
    expect(counts[0]?.colour).not.toBe(counts[1]?.colour);
    expect(counts[0]?.colour).toBe(counts[2]?.colour);
  });

  test("of a spec is the spec's, dots and all", () => {
    expect(named("spec: ant.main.carry grows", scene(), 0)).toMatchObject({ words: "ant.main.carry grows", group: "specs" });
  });
});

describe("the curves that are shown", () => {
  const states = Array.from({ length: 15 }, (_, k) => `ant.main.s${k}`);
  const names = [...states, "food.amount", "spec: grows"];

  test("are at first the specs and a dozen states", () => {
    const { store } = wired();
    store.set("scene", scene());
    const chosen = new Chosen();
    chosen.renew(names, store);
    expect(chosen.all).toHaveLength(17);
    expect(chosen.shown.map((each) => each.name)).toEqual([...states.slice(0, 12), "spec: grows"]);
  });

  test("are those ticked by hand, whatever comes", () => {
    const { store } = wired();
    store.set("scene", scene());
    const chosen = new Chosen();
    chosen.hand.set("ant.main.s0", false);
    chosen.hand.set("food.amount", true);
    chosen.renew(["ant.main.s0", "ant.main.s1", "food.amount"], store);
    expect(chosen.shown.map((each) => each.name)).toEqual(["ant.main.s1", "food.amount"]);
  });
});
