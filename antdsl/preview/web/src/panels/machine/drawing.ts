// A state chart as SVG, with the server's layout. States are buttons with counts; the width of arrows shows the rate of changes.

import type { Chart, ChartArrow, ChartBox } from "../../protocol";
import { css, setText, svg, formatNumber } from "../dom";

const HEAD = 7;
const RATE = 21; // px; width of an arrow at half of the maximum rate
const LARGEST = 1.25; // maximum magnification of small charts

export class ChartDrawing {
  readonly element: SVGSVGElement;
  private readonly boxes = new Map<string, { count: SVGTextElement; group: SVGGElement }>();
  private readonly arrows: {
    arrow: ChartArrow;
    line: SVGPolylineElement;
    rate: SVGTextElement;
    x: number;
    title: SVGTitleElement;
  }[] = [];
  private readonly names: Map<string, string>;
  private readonly fitted: (() => void)[] = []; // each fits one element to the font size

  constructor(
    private readonly chart: Chart,
    chosen: (state: string) => void,
  ) {
    this.names = new Map(chart.boxes.map((box) => [box.key, box.name]));
    this.element = svg("svg", {
      viewBox: `-4 -4 ${chart.width + 8} ${chart.height + 8}`,
      class: "states",
      role: "group",
      "aria-label": chart.title,
    });
    this.element.style.maxWidth = `${(chart.width + 8) * LARGEST}px`;
    for (const arrow of chart.arrows) this.element.append(this.arrow(arrow));
    for (const box of chart.boxes) this.element.append(this.box(box, chosen));
  }

  /** Keep the font as large as elsewhere on the page, even in a small chart. Arrow labels without space are hidden. */
  fit(): void {
    const room = this.element.getBoundingClientRect();
    if (!room.width) return;
    const scale = Math.min(room.width / (this.chart.width + 8), room.height / (this.chart.height + 8));
    const letter = Math.max(1, fontScale() / scale);
    this.element.style.setProperty("--letter", `${letter}px`);
    this.element.classList.toggle("small", scale < 0.8);
    for (const fit of this.fitted) fit();
    const all = this.element.getBBox(); // boxes may exceed the view box now
    this.element.setAttribute("viewBox", [all.x - 4, all.y - 4, all.width + 8, all.height + 8].join(" "));
    const [least, most] = [all.x + RATE * letter, all.x + all.width - RATE * letter];
    for (const { rate, x } of this.arrows) rate.setAttribute("x", String(Math.min(Math.max(x, least), most)));
  }

  counts(counts: ReadonlyMap<string, number>): void {
    for (const [name, box] of this.boxes) {
      const count = counts.get(name) ?? 0;
      setText(box.count, String(count));
      box.group.setAttribute("aria-label", `${name}: ${count} agents`);
      box.group.classList.toggle("empty", count === 0);
    }
  }

  /** Set the rates, by `from->to` or `from to`, with names as in the server's counts. */
  flow(rates: ReadonlyMap<string, number>): void {
    const most = Math.max(...rates.values(), 1);
    for (const { arrow, line, rate, title } of this.arrows) {
      const [from, to] = [this.names.get(arrow.source) ?? "", this.names.get(arrow.target) ?? ""];
      const now = rates.get(`${from}->${to}`) ?? 0;
      line.style.strokeWidth = String(1 + (now / most) * 4);
      line.classList.toggle("busy", now > 0);
      setText(rate, now > 0 ? `${formatNumber(Number(now.toPrecision(2)))}/s` : "");
      setText(
        title,
        [arrow.lines.join("\n"), arrow.details, now > 0 ? `${formatNumber(now)} a second` : ""].filter(Boolean).join("\n"),
      );
    }
  }

  mark(state: string | null): void {
    for (const [name, box] of this.boxes) box.group.classList.toggle("here", name === state);
  }

  private box(box: ChartBox, chosen: (state: string) => void): SVGElement {
    const [x, y] = box.centre;
    const group = svg("g", { class: `box ${box.kind}` });
    const title = svg("title");
    title.textContent = [box.name, box.label !== box.name && box.label, box.details].filter(Boolean).join("\n");
    group.append(title);
    if (box.kind === "start") {
      group.append(svg("circle", { cx: x, cy: y, r: Math.min(box.width, box.height) / 2 }));
      return group;
    }
    const shape = svg("rect", {
      x: x - box.width / 2,
      y: y - box.height / 2,
      width: box.width,
      height: box.height,
      rx: box.kind === "state" ? 8 : 4,
    });
    const label = svg("text", { x, y, class: "label" });
    label.textContent = box.kind === "state" ? box.name : box.label;
    group.append(shape, label);
    if (box.kind !== "state") return group;
    shape.style.fill = css(box.colour);
    label.style.fill = onTop(box.colour);
    const count = svg("text", { x, y, class: "number" });
    count.style.fill = onTop(box.colour);
    this.fitted.push(() => {
      const width = Math.max(box.width, label.getBBox().width + 12);
      const height = Math.max(box.height, label.getBBox().height * 2 + 6);
      for (const [name, value] of Object.entries({ x: x - width / 2, y: y - height / 2, width, height }))
        shape.setAttribute(name, String(value));
    });
    count.dataset.test = `count-${box.name}`;
    group.append(count);
    group.dataset.test = `state-${box.name}`;
    group.setAttribute("role", "button");
    group.setAttribute("tabindex", "0");
    group.addEventListener("click", () => chosen(box.name));
    group.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      event.stopPropagation();
      chosen(box.name);
    });
    this.boxes.set(box.name, { count, group });
    return group;
  }

  private arrow(arrow: ChartArrow): SVGElement {
    const group = svg("g", { class: arrow.interrupt ? "arrow interrupt" : "arrow" });
    const title = svg("title");
    title.textContent = [arrow.lines.join("\n"), arrow.details].filter(Boolean).join("\n");
    const line = svg("polyline", {
      points: shortened(arrow.points)
        .map((point) => point.join(","))
        .join(" "),
    });
    const wide = svg("polyline", { points: arrow.points.map((point) => point.join(",")).join(" "), class: "touch" });
    group.append(title, wide, line, head(arrow.points));
    const words = arrow.words;
    const rate = svg("text", { class: "rate", x: 0, y: 0 });
    const [x, y] = words ? words.centre : middle(arrow.points);
    if (words) {
      const { height } = words;
      const text = svg("text", { class: "words" });
      arrow.lines.forEach((each, k) => {
        const row = svg("tspan", { x, y: y - height / 2 + ((k + 0.72) * height) / arrow.lines.length });
        row.textContent = each;
        text.append(row);
      });
      group.append(text);
    }
    rate.setAttribute("x", String(x));
    rate.setAttribute("y", String(y));
    if (words) {
      rate.classList.add("beside");
      rate.style.setProperty("--below", `${words.height / 2 + 8}px`);
    }
    group.append(rate);
    this.arrows.push({ arrow, line, rate, x, title });
    return group;
  }
}

/** Return the ratio between the browser's font size and the font size of the layout. */
function fontScale(): number {
  return Number.parseFloat(getComputedStyle(document.documentElement).fontSize) / 13;
}

type Point = [number, number];

function head(points: Point[]): SVGElement {
  const tip = points.at(-1) as Point;
  const [ux, uy] = towards(points);
  const at = (back: number, aside: number) => [tip[0] - ux * back - uy * aside, tip[1] - uy * back + ux * aside].join(",");
  return svg("polygon", { points: `${tip.join(",")} ${at(HEAD + 2, HEAD / 2)} ${at(HEAD + 2, -HEAD / 2)}` });
}

/** Return the points of an arrow's path without its head, so that a wide line stays within the head. */
function shortened(points: Point[]): Point[] {
  const tip = points.at(-1) as Point;
  const [ux, uy] = towards(points);
  return [...points.slice(0, -1), [tip[0] - ux * HEAD, tip[1] - uy * HEAD]];
}

function towards(points: Point[]): Point {
  const [from, tip] = points.slice(-2) as [Point, Point];
  const length = Math.hypot(tip[0] - from[0], tip[1] - from[1]) || 1;
  return [(tip[0] - from[0]) / length, (tip[1] - from[1]) / length];
}

function middle(points: Point[]): Point {
  return points[points.length >> 1] as Point;
}

/** Return black or white, whichever has more contrast with a colour, by relative luminance. */
function onTop([r, g, b]: readonly [number, number, number]): string {
  const linear = (v: number) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
  return 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b) > 0.18 ? "#101010" : "#ffffff";
}
