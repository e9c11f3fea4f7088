import { describe, expect, test } from "vitest";
import { creased } from "../src/view/creases";
import { Herd, Rows } from "../src/view/herds/herd";
import { partOf } from "../src/view/herds/herds";
import { speck } from "../src/view/bodies/speck";
import { acts, frame, herd, species } from "./made";

function placed(of: Herd, row: number, t: number): number[] {
  const at = { x: 0, y: 0, z: 0 };
  of.place(row, t, at);
  return [at.x, at.y, at.z];
}

describe("a herd between two frames", () => {
  test("goes from where each was to where it is", () => {
    const ants = herd(frame([3, 8], [0, 0, 0, 10, 0, 0]));
    ants.take(frame([3, 8], [2, 0, 0, 10, 4, 0]), 1, false);
    expect(placed(ants, 0, 0)).toEqual([0, 0, 0]);
    expect(placed(ants, 0, 0.5)).toEqual([1, 0, 0]);
    expect(placed(ants, 1, 1)).toEqual([10, 4, 0]);
  });

  test("goes on from where it is shown, when a frame comes before the way is done", () => {
    const ants = herd(frame([3], [0, 0, 0]));
    ants.take(frame([3], [2, 0, 0]), 1, false);
    ants.take(frame([3], [4, 0, 0]), 0.5, false);
    expect(placed(ants, 0, 0)).toEqual([1, 0, 0]);
    expect(placed(ants, 0, 1)).toEqual([4, 0, 0]);
  });

  test("knows everyone by id, whoever died or was born", () => {
    const ants = herd(frame([1, 2, 3], [1, 0, 0, 2, 0, 0, 3, 0, 0]));
    ants.take(frame([2, 3, 9], [2, 1, 0, 3, 1, 0, 9, 1, 0]), 1, false);
    expect(placed(ants, 0, 0)).toEqual([2, 0, 0]);
    expect(placed(ants, 1, 0)).toEqual([3, 0, 0]);
    expect(placed(ants, 2, 0)).toEqual([9, 1, 0]); // born: it stands where it is
    expect([1, 2, 3, 9].map((id) => ants.row(id))).toEqual([-1, 0, 1, 2]);
  });

  test("leaps where time does, and where nobody can have walked", () => {
    const ants = herd(frame([1, 2], [0, 0, 0, 0, 0, 0]));
    ants.take(frame([1, 2], [39, 0, 0, 41, 0, 0]), 1, false);
    expect(placed(ants, 0, 0)).toEqual([0, 0, 0]);
    expect(placed(ants, 1, 0)).toEqual([41, 0, 0]);
    ants.take(frame([1, 2], [40, 0, 0, 42, 0, 0]), 1, true);
    expect(placed(ants, 0, 0)).toEqual([40, 0, 0]);
  });

  test("turns gradually, and looks along +x without a direction", () => {
    const ants = herd(frame([1], [0, 0, 0]));
    ants.take(frame([1], [0, 0, 0], { heading: Int8Array.of(0, 0, 127) }), 1, false);
    const at = { x: 0, y: 0, z: 0 };
    ants.turn("head", 0, 0, at);
    expect(at).toEqual({ x: 1, y: 0, z: 0 });
    ants.turn("head", 0, 1, at);
    expect(at).toEqual({ x: 0, y: 0, z: 1 });
    ants.turn("up", 0, 0.5, at);
    expect(at).toEqual({ x: 0, y: 1, z: 0 });
  });

  test("idles by the clock of the frame, each from a start of its own", () => {
    const ants = herd(frame([1, 2], [0, 0, 0, 0, 0, 0]));
    ants.acting(acts({ loops: [true], idle: [0, 2] }));
    const turn = (row: number) => ants.plays.data[16 * row + 5] as number;
    expect(turn(0)).toBeCloseTo(0.618, 3);
    expect(turn(1)).toBeCloseTo(0.236, 3);
    ants.clock = 1;
    ants.take(frame([1, 2], [0, 0, 0, 0, 0, 0]), 1, false);
    expect(turn(0)).toBeCloseTo(0.118, 3);
    expect((ants.plays.data[4] as number) - turn(0)).toBeCloseTo(-0.5, 3); // through the end of the clip
  });

  test("is split by body, with all that frames say of each agent", () => {
    const all = frame([1, 2, 5], [0, 0, 0, 1, 2, 3, 4, 5, 6], { body: Uint8Array.of(0, 1, 1), speed: Float32Array.of(7, 8, 9) });
    const part = new Herd(species({ bodies: ["ant#0", "ant#1"] }), "ant#1");
    part.take(partOf(all, "ant", 1), 1, true);
    expect([...part.ids]).toEqual([2, 5]);
    expect(placed(part, 1, 1)).toEqual([4, 5, 6]);
    expect([...(part.column("speed") ?? [])]).toEqual([8, 9]);
    expect(partOf(frame([], []), "ant", 0).arrays.get("ant/id")?.length).toBe(0);
  });

  test("has columns of its own species", () => {
    const ants = herd(frame([1], [0, 0, 0], { speed: Float32Array.of(4) }));
    expect(ants.column("speed")?.[0]).toBe(4);
    expect(ants.column("state/main")).toBeUndefined();
    expect(ants.size(0)).toBe(1);
  });
});

test("rows have new arrays only when there is no room, and say so", () => {
  const rows = new Rows();
  rows.reserve(10);
  const { version, capacity } = rows;
  expect(capacity).toBeGreaterThanOrEqual(10);
  rows.reserve(capacity);
  expect(rows.version).toBe(version);
  rows.reserve(capacity + 1);
  expect(rows.version).toBe(version + 1);
});

describe("the normals of a mesh", () => {
  /** Two triangles along the x axis, the second turned up by an angle. */
  const fold = (angle: number) => {
    const [y, z] = [Math.sin(angle), -Math.cos(angle)];
    const position = Float32Array.of(0, 0, 0, 1, 0, 0, 0, 0, 1, 0, y, z);
    return creased(position, Uint32Array.of(0, 2, 1, 0, 1, 3));
  };
  const normals = (angle: number) => fold(angle).getAttribute("normal");

  test("are the mean of the faces where the ground is smooth", () => {
    const normal = normals(0.2);
    expect(normal.count).toBe(4);
    expect(normal.getY(0)).toBeCloseTo(Math.cos(0.1), 3);
    expect(normal.getZ(0)).toBeCloseTo(Math.sin(0.1), 3);
  });

  test("are the faces' own at a sharp edge, whose corners stand twice", () => {
    const bent = fold(Math.PI / 2);
    const normal = bent.getAttribute("normal");
    expect(normal.count).toBe(8);
    const corners = [...(bent.getIndex()?.array ?? [])].map((k) =>
      [normal.getX(k), normal.getY(k), normal.getZ(k)].map((part) => Math.round(part) + 0),
    );
    expect(corners.slice(0, 3)).toContainEqual([0, 1, 0]);
    expect(corners.slice(3)).toContainEqual([0, 0, 1]);
    expect(corners[0]).not.toEqual(corners[3]);
  });
});

test("a speck is as long and wide as the trunk that it stands for", () => {
  const made = speck(Float32Array.of(-2, 0, 0, 4, 1, 0, 1, 0.5, 3));
  const along = (axis: number) => [...made.position].filter((_, k) => k % 3 === axis);
  expect([Math.min(...along(0)), Math.max(...along(0))]).toEqual([-2, 4]);
  expect([Math.min(...along(1)), Math.max(...along(1))]).toEqual([expect.closeTo(0.3), 1]);
  expect(Math.max(...along(2))).toBeCloseTo(1.5 + 1.5 * 1.25);
  expect(Math.max(...made.face)).toBe(made.position.length / 3 - 1);
});
