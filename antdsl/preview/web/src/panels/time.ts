// The foot: a slider over all that was simulated, with the curves above it on the same scale of frames.

import type { Store } from "../store";
import { el, painted, say, throttled } from "./dom";
import { seek, toggle } from "./playing";
import { Chart } from "./time/chart";
import { CurveData } from "./time/data";
import { chooser } from "./time/chooser";
import { legend } from "./time/legend";

const DRAGGED = 40; // ms between two frames that are asked for while one drags

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
  const draw = painted(() => chart.draw());
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
    say(first, status ? String(status.first) : "");
    say(head, status ? [String(status.head), last && `the scene ends at ${last}`].filter(Boolean).join(" · ") : "");
    say(mode, status?.light ? "remembered: let go to see all of it" : "");
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

/** While it is dragged what is remembered is shown; once it is let go the frame is simulated. */
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
    if (!event.shiftKey || to === undefined) return; // without shift the slider itself goes one frame
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
