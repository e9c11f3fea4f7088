import { ensureSyntaxTree } from "@codemirror/language";
import { EditorState } from "@codemirror/state";
import { beforeEach, describe, expect, test, vi } from "vitest";
import { Flow } from "../src/panels/machine/flow";
import { range, stepOf, written } from "../src/panels/side/ranges";
import { ant, yaml } from "../src/panels/text/colouring";
import { same, shortName } from "../src/panels/text/files";
import type { Chart } from "../src/protocol";
import { param, scene, status, type Wire, wired } from "./made";

describe("a slider's range", () => {
  test("is the one that the text gives", () => {
    expect(range(param({ low: 10, high: 80 }))).toEqual({ low: 10, high: 80, offered: "" });
  });

  test("is offered, and said, where the text gives none", () => {
    expect(range(param())).toEqual({ low: 0, high: 100, offered: "(The text gives no range: 0 to 100 mm is offered.)" });
    expect(range(param({ unit: "" })).offered).toBe("(The text gives no range: 0 to 100 is offered.)");
  });

  test("reaches below zero for a value that is below, and past a value that was set further out", () => {
    expect(range(param({ written: "-5 mm", number: -5 }))).toMatchObject({ low: -10, high: 10 });
    expect(range(param({ number: 300 }))).toMatchObject({ low: 0, high: 600 });
    expect(range(param({ written: "0", number: 0 }))).toMatchObject({ low: 0, high: 2 });
  });

  test("keeps the one end that the text gives", () => {
    expect(range(param({ low: 20 }))).toMatchObject({ low: 20, high: 120 });
    expect(range(param({ high: 60 }))).toMatchObject({ low: 0, high: 60 });
  });

  test.each([
    [0, 200, 1],
    [0, 100, 0.5],
    [0, 1, 0.005],
    [0, 30, 0.2],
    [-10, 10, 0.1],
    [0, 1e6, 5000],
    [3, 3, 1],
  ])("from %d to %d goes in steps of %d", (low, high, step) => {
    expect(stepOf(low, high)).toBe(step);
  });

  test("is about the number that the files have, where it is one", () => {
    expect(written(param({ written: "12.5 mm" }))).toBe(12.5);
    expect(written(param({ written: "half of it", number: 7 }))).toBe(7);
  });
});

test("a file is the same in short and with its folders, and only then", () => {
  expect(same("ants.ant", "examples/x/ants.ant")).toBe(true);
  expect(same("examples/x/ants.ant", "ants.ant")).toBe(true);
  expect(same("giants.ant", "ants.ant")).toBe(false);
  expect(shortName("examples/x/ants.ant")).toBe("ants.ant");
});

describe("the traffic between states", () => {
  const chart: Chart = { species: "ant", machine: "main", title: "", width: 1, height: 1, boxes: [], arrows: [] };
  let wire: Wire;
  let flow: Flow;
  const tell = (frame: number, count: number, more = {}) =>
    wire.receive(status({ frame, transitions: { "ant.search->carry": count, "antlion.sit->leap": 50 * count }, ...more }));

  beforeEach(() => {
    const made = wired();
    wire = made.wire;
    flow = new Flow(made.store);
    wire.receive(scene());
  });

  test("is not known from one frame", () => {
    tell(0, 5);
    expect(flow.rates(chart)).toEqual(new Map());
  });

  test("is counted a second of the scene's time, of this species alone", () => {
    tell(0, 5);
    tell(5, 8);
    expect(flow.rates(chart)).toEqual(new Map([["search->carry", 6]]));
  });

  test("is that of the last second", () => {
    for (const [frame, count] of [
      [0, 0],
      [10, 100],
      [20, 101],
    ] as const)
      tell(frame, count);
    expect(flow.rates(chart).get("search->carry")).toBe(1);
  });

  test("is forgotten when one goes back, and of another scene", () => {
    tell(0, 0);
    tell(5, 10);
    tell(2, 4);
    expect(flow.rates(chart)).toEqual(new Map());
    tell(4, 5);
    expect(flow.rates(chart).get("search->carry")).toBe(5);
    wire.receive(scene());
    expect(flow.rates(chart)).toEqual(new Map());
  });

  test("is not counted from what is remembered only", () => {
    tell(0, 0);
    tell(5, 10, { light: true });
    expect(flow.rates(chart)).toEqual(new Map());
  });
});

describe("time by keys and buttons", () => {
  const open = async (now: Parameters<typeof status>[0]) => {
    vi.resetModules(); // what was wished for is kept by the module
    const playing = await import("../src/panels/playing");
    const { store, wire } = wired();
    playing.watchStatus(store);
    wire.receive(status(now));
    return { ...playing, store, wire };
  };

  test("plays and pauses, and counts as done before the server confirms it", async () => {
    const { toggle, playing, store, wire } = await open({ playing: false });
    toggle(store);
    expect(playing(store)).toBe(true);
    toggle(store);
    expect(playing(store)).toBe(false);
    expect(wire.sent).toEqual([{ op: "play" }, { op: "pause" }]);
  });

  test("follows the status again after the server confirms the request", async () => {
    const { toggle, playing, store, wire } = await open({ playing: false });
    toggle(store);
    wire.receive(status({ playing: false })); // was on its way
    expect(playing(store)).toBe(true);
    wire.receive(status({ playing: true }));
    wire.receive(status({ playing: false }));
    expect(playing(store)).toBe(false);
  });

  test("goes to frames that are there, no further back than the first", async () => {
    const { move, store, wire } = await open({ frame: 5, first: 3, head: 9 });
    move(store, 2);
    move(store, -10);
    expect(wire.sent).toEqual([
      { op: "seek", frame: 7, exact: true },
      { op: "seek", frame: 3, exact: true },
    ]);
  });

  test("simulates past the last frame, from there", async () => {
    const { move, store, wire } = await open({ frame: 8, head: 9 });
    move(store, 10);
    expect(wire.sent).toEqual([
      { op: "seek", frame: 9, exact: true },
      { op: "step", count: 9 },
    ]);
  });

  test("stands still before it goes elsewhere", async () => {
    const { seek, store, wire } = await open({ playing: true });
    seek(store, 4, false);
    expect(wire.sent).toEqual([{ op: "pause" }, { op: "seek", frame: 4, exact: false }]);
  });
});

describe("the colours of a text", () => {
  const pieces = (language: typeof ant, doc: string) => {
    const tree = ensureSyntaxTree(EditorState.create({ doc, extensions: [language] }), doc.length);
    const found: [string, string][] = [];
    tree?.iterate({
      enter: ({ name, from, to }) => {
        if (name !== "Document") found.push([name, doc.slice(from, to)]);
      },
    });
    return found;
  };

  test("of a scene are those of keys, numbers, units, words and remarks", () => {
    expect(pieces(yaml, "size: 12.5 mm # wide")).toEqual([
      ["entity-name-function", "size"],
      ["punctuation", ":"],
      ["constant-numeric", "12.5"],
      ["keyword-other-unit", " mm"],
      ["comment", "# wide"],
    ]);
  });

  test("of a program: remarks end with their line, and numbers are numbers", () => {
    const found = pieces(ant, "# every 3 s\nturn 3 deg");
    expect(found[0]).toEqual(["comment", "# every 3 s"]);
    expect(found.filter(([name]) => name === "comment")).toHaveLength(1);
    expect(found).toContainEqual(["constant-numeric", "3"]);
  });
});
