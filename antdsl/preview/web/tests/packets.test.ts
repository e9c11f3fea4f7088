import { describe, expect, test } from "vitest";
import { unpack } from "../src/protocol";

type Array = [name: string, type: string, count: number, offset: number];

/** A message with room for so many bytes of arrays behind its header. */
function message(header: Record<string, unknown>, place: (view: DataView) => void, room = 0): ArrayBuffer {
  const words = new TextEncoder().encode(JSON.stringify(header));
  const start = 8 * Math.ceil((8 + words.length) / 8);
  const bytes = new Uint8Array(start + room);
  bytes.set(new TextEncoder().encode("ant1"));
  const view = new DataView(bytes.buffer);
  view.setUint32(4, words.length, true);
  bytes.set(words, 8);
  place(view);
  return bytes.buffer;
}

describe("a packet", () => {
  test("has its slot, its header and its arrays at the offsets that the header names", () => {
    const arrays: Array[] = [
      ["ant/id", "i4", 2, 256],
      ["ant/position", "f4", 3, 264],
      ["ant/heading", "i1", 3, 280],
    ];
    const data = message(
      { slot: "frame", frame: 7, light: true, arrays },
      (view) => {
        view.setInt32(256, -5, true);
        view.setInt32(260, 900_000, true);
        view.setFloat32(264, 1.5, true);
        view.setFloat32(272, -0.25, true);
        view.setInt8(280, -127);
      },
      256,
    );
    const packet = unpack(data);
    expect(packet.slot).toBe("frame");
    expect(packet.header.frame).toBe(7);
    expect(packet.header.light).toBe(true);
    expect(packet.arrays.get("ant/id")).toEqual(Int32Array.of(-5, 900_000));
    expect(packet.arrays.get("ant/position")).toEqual(Float32Array.of(1.5, 0, -0.25));
    expect(packet.arrays.get("ant/heading")).toEqual(Int8Array.of(-127, 0, 0));
    expect(packet.arrays.size).toBe(3);
  });

  test.each([
    ["f4", Float32Array],
    ["u4", Uint32Array],
    ["u1", Uint8Array],
    ["u2", Uint16Array],
    ["i2", Int16Array],
  ] as const)("has arrays of %s", (type, kind) => {
    const arrays: Array[] = [["value", type, 1, 64]];
    const packet = unpack(message({ slot: "field:scent", arrays }, () => undefined, 64));
    expect(packet.arrays.get("value")).toBeInstanceOf(kind);
    expect(packet.arrays.get("value")).toHaveLength(1);
  });

  test("shares the message's memory: nothing is copied", () => {
    const data = message({ slot: "frame", arrays: [["x", "u1", 1, 64]] }, () => undefined, 64);
    const { arrays } = unpack(data);
    new Uint8Array(data)[64] = 9;
    expect(arrays.get("x")?.[0]).toBe(9);
  });

  test("has a header with words of any language", () => {
    expect(unpack(message({ slot: "item:Futter:Brösel 🐜", arrays: [] }, () => undefined)).slot).toBe("item:Futter:Brösel 🐜");
  });

  test("that does not begin as one is refused", () => {
    const data = message({ slot: "frame", arrays: [] }, (view) => view.setUint8(3, "2".charCodeAt(0)));
    expect(() => unpack(data)).toThrow("not a packet");
    expect(() => unpack(new ArrayBuffer(4))).toThrow("not a packet");
  });

  test("that is cut off is refused", () => {
    const data = message({ slot: "frame", arrays: [["x", "f4", 100, 64]] }, () => undefined, 64);
    expect(() => unpack(data)).toThrow(RangeError);
  });
});
