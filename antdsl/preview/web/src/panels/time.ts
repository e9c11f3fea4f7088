// The time line: a slider over all simulated frames, and the curves over the same frames.

import type { Store } from "../store";
import { el, oncePerRepaint, setText, throttled } from "./dom";
import { seek, toggle } from "./playing";
import { Chart } from "./time/chart";
import { CurveData } from "./time/data";
import { chooser } from "./time/chooser";
import { legend } from "./time/legend";

const DRAGGED = 40; // minimum ms between two requests while the slider is dragged

export function time(store: Store, place: HTMLElement): void {
  const data = new CurveData();
  const canvas = el("canvas", { class: "chart", test: "curves", role: "img", "aria-label": "Curves over time" });
  const slider = el("input", {
    type: "range",
    class: "scrub",
    test: "scrub",
    step: 1,
    min: 0,
    max: 0,
    "aria-label": "Frame",
    disabled: true,
  });
  const first = el("span", { class: "end" });
  const head = el("span", { class: "end" });
  const mode = el("span", { class: "mode", test: "light", role: "status" });
  const chart = new Chart(canvas, store, data);
  const draw = oncePerRepaint(() => chart.draw());
  const pick = chooser(store, data, draw);
  const track = el("div", { class: "track" }, canvas, slider);
  const aside = el("div", { class: "aside" }, el("div", { class: "row" }, pick, mode), legend(store, data, chart));
  place.append(track, aside);
  track.append(el("div", { class: "ends" }, first, head));

  store.connection.on("curves", (curves) => {
    data.take(curves);
    store.set("curves", curves);
    draw();
  });
  store.on(["status", "scene"], () => {
    showTime(store, slider);
    const status = store.now.status;
    const last = store.now.scene?.last;
    setText(first, status ? String(status.first) : "");
    setText(head, status ? [String(status.head), last && `the scene ends at ${last}`].filter(Boolean).join(" · ") : "");
    setText(mode, status?.light ? "stored data: release the slider to see everything" : "");
    draw();
  });
  store.connection.on("stops", ({ stops }) => {
    chart.stops = new Map(stops.map(({ frame, line }) => [frame, line]));
    draw();
  });
  document.addEventListener("theme", draw);
  new ResizeObserver(draw).observe(canvas);
  dragging(store, slider, draw);
  pointing(store, canvas, chart, draw);
}

function showTime(store: Store, slider: HTMLInputElement): void {
  const status = store.now.status;
  if (!status) return;
  slider.disabled = status.head <= status.first;
  slider.min = String(status.first);
  slider.max = String(Math.max(status.head, status.first + 1));
  if (!slider.matches(":active")) slider.value = String(status.frame);
  slider.setAttribute("aria-valuetext", `frame ${status.frame} of ${status.head}`);
}

/** While the slider is dragged, stored frames are displayed; the frame is simulated after the release. */
function dragging(store: Store, slider: HTMLInputElement, draw: () => void): void {
  let byPointer = false;
  const light = throttled(DRAGGED, (frame: number) => byPointer && seek(store, frame, false));
  slider.addEventListener("pointerdown", () => {
    byPointer = true;
  });
  slider.addEventListener("input", () => {
    if (byPointer) light(Number(slider.value));
    draw();
  });
  slider.addEventListener("change", () => {
    byPointer = false;
    seek(store, Number(slider.value));
  });
  slider.addEventListener("keydown", (event) => {
    const to = { ArrowLeft: -10, ArrowRight: 10 }[event.key];
    if (!event.shiftKey || to === undefined) return; // without shift, the slider itself moves by one frame
    event.preventDefault();
    slider.value = String(Number(slider.value) + to);
    seek(store, Number(slider.value));
  });
  slider.addEventListener("keydown", (event) => {
    if (event.key !== " ") return;
    event.preventDefault();
    toggle(store);
  });
}

function pointing(store: Store, canvas: HTMLCanvasElement, chart: Chart, draw: () => void): void {
  canvas.addEventListener("pointermove", (event) => {
    chart.hover = chart.frameAt(event.offsetX);
    draw();
  });
  canvas.addEventListener("pointerleave", () => {
    chart.hover = null;
    draw();
  });
  canvas.addEventListener("click", (event) => {
    const frame = chart.frameAt(event.offsetX);
    if (frame !== null) seek(store, frame);
  });
}
