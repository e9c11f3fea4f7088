import { describe, expect, test } from "vitest";
import { Feet, STANCE } from "../src/view/herds/feet";
import { NONE, Plays, TEXELS } from "../src/view/herds/plays";

const HALF = 32768;
const ALL = 65535;

/** What one machine of one agent shows, `t` of the way: clip and the one before, turns and weights of both. */
function shown(plays: Plays, row: number, t: number) {
  const k = row * 4 * TEXELS;
  const at = (place: number) => {
    const [a, b] = [plays.data[k + place] as number, plays.data[k + place + 1] as number];
    return a + (b - a) * t;
  };
  return { clips: [plays.data[k], plays.data[k + 1]], turns: [at(4), at(6)], weights: [at(10), at(12)] };
}

function playing(...frames: number[][]): Plays {
  const plays = new Plays();
  plays.begin(["main"], [true, false]);
  for (const values of frames) {
    const count = values.length / 6;
    plays.take(
      [Uint16Array.from(values)],
      count,
      Int32Array.from({ length: count }, (_, k) => k),
      1,
    );
  }
  return plays;
}

describe("what agents play between two frames", () => {
  test("goes on through the end of a clip that begins again", () => {
    const plays = playing([0, NONE, 0.9 * ALL, 0, ALL, 0], [0, NONE, 0.1 * ALL, 0, ALL, 0]);
    expect(shown(plays, 0, 0).turns[0]).toBeCloseTo(-0.1, 3);
    expect(shown(plays, 0, 0.5).turns[0]).toBeCloseTo(0, 3);
    expect(shown(plays, 0, 1).turns[0]).toBeCloseTo(0.1, 3);
  });

  test("begins at once where a clip that ends is played again", () => {
    const plays = playing([1, NONE, 0.9 * ALL, 0, ALL, 0], [1, NONE, 0.1 * ALL, 0, ALL, 0]);
    expect(shown(plays, 0, 0).turns[0]).toBeCloseTo(0.1, 3);
  });

  test("fades from the clip before to the one that takes its place", () => {
    const plays = playing([0, NONE, HALF, 0, ALL, 0], [1, 0, 0, HALF, 0.25 * ALL, 0.75 * ALL]);
    expect(shown(plays, 0, 0)).toMatchObject({ clips: [1, 0], weights: [0, expect.closeTo(1, 3)] });
    expect(shown(plays, 0, 0.5).weights).toEqual([expect.closeTo(0.125, 3), expect.closeTo(0.875, 3)]);
    expect(shown(plays, 0, 1).weights).toEqual([expect.closeTo(0.25, 3), expect.closeTo(0.75, 3)]);
  });

  test("changes at once where nothing gives way, and never shows nobody's pose", () => {
    const plays = playing([0, NONE, HALF, 0, ALL, 0], [1, NONE, 0, 0, ALL, 0]);
    expect(shown(plays, 0, 0)).toMatchObject({ clips: [1, NONE], weights: [1, 0] });
  });

  test("follows agents by their rows, and stays where a frame does not tell", () => {
    const plays = playing([0, NONE, 0, 0, ALL, 0, 1, NONE, HALF, 0, ALL, 0]);
    const { version } = plays;
    plays.take([undefined], 1, Int32Array.of(1), 1); // the first is gone, and the frame is a remembered one
    expect(shown(plays, 0, 0)).toEqual(shown(plays, 0, 1));
    expect(shown(plays, 0, 1)).toMatchObject({ clips: [1, NONE], turns: [expect.closeTo(0.5, 3), 0], weights: [1, 0] });
    expect(plays.version).toBeGreaterThan(version);
    plays.take([undefined], 2, Int32Array.of(0, -1), 1);
    expect(shown(plays, 1, 1)).toMatchObject({ clips: [NONE, NONE], weights: [0, 0] });
  });
});

describe("feet between two frames", () => {
  const stance = (rise: number, down: number) => [rise * 4096, 0, 0, 0, 32767, down];
  const places = (x: number) => Int16Array.of(4096 * x, 0, 0, 0, 0, 4096);

  test("go from where they are shown to where they are", () => {
    const feet = new Feet();
    feet.begin(2, false);
    expect(feet.hasData).toBe(false);
    feet.take([places(0.5), Int16Array.from(stance(0.25, 1))], 1, Int32Array.of(-1), 1);
    const first = 4 * STANCE;
    expect([...feet.data.subarray(0, 8)]).toEqual([0.25, 0, 0, 0, 0.25, 0, 0, 0]);
    expect([...feet.data.subarray(first, first + 8)]).toEqual([0.5, 0, 0, 1, 0.5, 0, 0, 1]);
    feet.take([places(1), Int16Array.from(stance(0.5, 2))], 1, Int32Array.of(0), 1);
    feet.take([places(2), Int16Array.from(stance(0.5, 2))], 1, Int32Array.of(0), 0.5);
    expect([...feet.data.subarray(first, first + 8)]).toEqual([0.75, 0, 0, 0.5, 2, 0, 0, 0]);
    expect([...feet.data.subarray(first + 8, first + 16)]).toEqual([0, 0, 1, 0.5, 0, 0, 1, 1]);
    expect([...feet.data.subarray(8, 10)]).toEqual([1, 1]);
  });

  test("stay where a frame does not tell of them", () => {
    const feet = new Feet();
    feet.begin(2, false);
    feet.take([undefined, undefined], 1, Int32Array.of(-1), 1);
    expect(feet.hasData).toBe(false);
    feet.take([places(0.5), Int16Array.from(stance(0.25, 1))], 1, Int32Array.of(-1), 1);
    feet.take([undefined, undefined], 1, Int32Array.of(0), 1);
    expect([...feet.data.subarray(4 * STANCE, 4 * STANCE + 8)]).toEqual([0.5, 0, 0, 1, 0.5, 0, 0, 1]);
  });

  test("turn their soles", () => {
    const feet = new Feet();
    feet.begin(1, true);
    const take = (x: number, from: number) =>
      feet.take(
        [Int16Array.of(0, 0, 0), Int16Array.from(stance(0, 1)), Int16Array.of(32767 * x, 32767, 0)],
        1,
        Int32Array.of(from),
        1,
      );
    take(0, -1);
    take(0.5, 0);
    expect(feet.width).toBe(4 * (STANCE + 4));
    expect([...feet.data.subarray(4 * (STANCE + 2), feet.width)]).toEqual([0, 1, 0, 0, expect.closeTo(0.5, 4), 1, 0, 0]);
  });

  test("are none of a body without legs", () => {
    const feet = new Feet();
    feet.begin(0, false);
    feet.take([places(0.5), Int16Array.from(stance(0, 0))], 1, Int32Array.of(-1), 1);
    expect(feet.hasData).toBe(false);
  });
});
