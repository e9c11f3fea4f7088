import { afterEach, beforeEach, describe, expect, test, vi } from "vitest";
import { css, keyed, type Row, formatNumber, throttled } from "../src/panels/dom";

describe("a number as people write it", () => {
  test.each([
    [0, "0"],
    [12, "12"],
    [-3, "-3"],
    [0.1 + 0.2, "0.3"],
    [Math.PI, "3.142"],
    [1234.567, "1235"],
    [0.000123456, "0.0001235"],
    [12345.6, "12346"],
    [-98765.4, "-98765"],
    [1e7, "10000000"],
    [Number.NaN, "—"],
    [Number.POSITIVE_INFINITY, "—"],
  ])("%d is %s", (value, words) => {
    expect(formatNumber(value)).toBe(words);
  });
});

test("a colour has bytes in style sheets", () => {
  expect(css([0, 0.5, 1])).toBe("rgb(0 128 255)");
});

/** As much of an element as a list touches, with a count of how often something was put in. */
class Box {
  readonly inside: Box[] = [];
  puts = 0;
  private over: Box | null = null;

  constructor(readonly name = "") {}

  get firstElementChild(): Box | null {
    return this.inside[0] ?? null;
  }

  get nextElementSibling(): Box | null {
    const all = this.over?.inside ?? [];
    return all[all.indexOf(this) + 1] ?? null;
  }

  insertBefore(box: Box, before: Box | null): void {
    box.remove();
    this.inside.splice(before ? this.inside.indexOf(before) : this.inside.length, 0, box);
    box.over = this;
    this.puts++;
  }

  remove(): void {
    this.over?.inside.splice(this.over.inside.indexOf(this), 1);
    this.over = null;
  }
}

describe("a list by keys", () => {
  let place: Box;
  let made: string[];
  let updates: string[];
  let show: (items: readonly { key: string; words: string }[]) => void;
  const names = () => place.inside.map((each) => each.name);
  const items = (keys: string) => [...keys].map((key) => ({ key, words: `${key}!` }));

  beforeEach(() => {
    place = new Box();
    made = [];
    updates = [];
    const row = ({ key }: { key: string }): Row<{ key: string; words: string }> => {
      made.push(key);
      return { element: new Box(key) as unknown as Element, update: ({ words }) => updates.push(words) };
    };
    show = keyed(place as unknown as Element, (each) => each.key, row);
  });

  test("has a row for each, in order, with its contents", () => {
    show(items("abc"));
    expect(names()).toEqual(["a", "b", "c"]);
    expect(updates).toEqual(["a!", "b!", "c!"]);
  });

  test("makes no row twice, and moves none that stays", () => {
    show(items("abc"));
    const [a] = place.inside;
    const before = place.puts;
    show(items("abc"));
    expect(made).toEqual(["a", "b", "c"]);
    expect(place.inside[0]).toBe(a);
    expect(place.puts).toBe(before);
  });

  test("takes away what is gone and leaves the others where they are", () => {
    show(items("abcd"));
    const before = place.puts;
    show(items("ad"));
    expect(names()).toEqual(["a", "d"]);
    expect(place.puts).toBe(before);
  });

  test("puts what is new in its place", () => {
    show(items("ad"));
    const before = place.puts;
    show(items("abcd"));
    expect(names()).toEqual(["a", "b", "c", "d"]);
    expect(place.puts).toBe(before + 2);
  });

  test("follows another order with the same rows", () => {
    show(items("abc"));
    const rows = new Set(place.inside);
    show(items("cab"));
    expect(names()).toEqual(["c", "a", "b"]);
    expect(new Set(place.inside)).toEqual(rows);
  });

  test("makes a row anew that was gone and comes back", () => {
    show(items("ab"));
    show([]);
    expect(names()).toEqual([]);
    show(items("b"));
    expect(made).toEqual(["a", "b", "b"]);
  });
});

describe("what is throttled", () => {
  beforeEach(() => void vi.useFakeTimers());
  afterEach(() => void vi.useRealTimers());

  test("runs at once, then at most once in a while, with the last arguments", () => {
    const done: number[] = [];
    const act = throttled(100, (value: number) => done.push(value));
    act(1);
    expect(done).toEqual([1]);
    act(2);
    act(3);
    vi.advanceTimersByTime(99);
    expect(done).toEqual([1]);
    vi.advanceTimersByTime(1);
    expect(done).toEqual([1, 3]);
    vi.advanceTimersByTime(500);
    expect(done).toEqual([1, 3]);
    act(4);
    expect(done).toEqual([1, 3, 4]);
  });
});
