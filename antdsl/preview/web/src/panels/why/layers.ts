// The layers: one bar for the whole strength with the share of each layer, and the parts that were cut.

import { HUES } from "../../hues";
import type { Explanation } from "../../explanation";
import type { Triple } from "../../protocol";
import type { Store } from "../../store";
import { el, formatNumber } from "../dom";
import { conditionParts, link, section } from "./parts";

type Layer = Explanation["layers"][number];

const TITLES: Record<string, string> = {
  budget: "Layers, from top to bottom until the strength is used",
  sum: "Layers, added",
  first: "Layers, the first takes all",
};

export function layers(store: Store, e: Explanation): HTMLElement {
  if (!e.layers.length) return section("Direction", together(e));
  const bar = el("div", {
    class: "budget",
    test: "budget",
    role: "img",
    "aria-label": e.layers.map((each) => `${each.place.text}: ${words(each)}`).join("; "),
  });
  e.layers.forEach((layer, k) => {
    if (layer.share <= 0) return;
    const piece = el("span", { title: `${layer.place.text}\n${words(layer)}` });
    piece.style.width = `${Math.min(1, layer.share) * 100}%`;
    piece.style.background = HUES[k % HUES.length] as string;
    bar.append(piece);
  });
  const rows = e.layers.map((layer, k) => row(store, layer, HUES[k % HUES.length] as string));
  const steers = e.steers.map((each) =>
    el("p", { class: "quiet" }, el("code", { text: each.text }), ` length ${formatNumber(each.length)}`),
  );
  return section(
    TITLES[e.mode] ?? "Layers",
    bar,
    el("ol", { class: "layers", test: "layer-list" }, ...rows),
    ...steers,
    together(e),
  );
}

function row(store: Store, layer: Layer, colour: string): HTMLElement {
  const swatch = el("span", { class: "swatch" });
  swatch.style.background = layer.share > 0 ? colour : "transparent";
  const wish = el("span", { class: "wish" });
  const given = el("span", { class: "given" });
  const cut = el("span", { class: "cut" });
  given.style.width = `${Math.min(1, layer.share) * 100}%`;
  given.style.background = colour;
  cut.style.width = `${Math.min(1, layer.cut) * 100}%`;
  wish.append(given, cut);
  const made = el(
    "li",
    { class: layer.state === "pushed" ? "" : "idle" },
    swatch,
    link(store, layer.place),
    el("span", { class: "quiet push", text: words(layer) }),
    layer.state === "pushed" && wish,
  );
  if (layer.condition) {
    const parts = conditionParts(layer.condition, false);
    if (parts) made.append(parts);
  }
  return made;
}

function words(layer: Layer): string {
  if (layer.state === "no strength") return "not evaluated: no strength is left";
  if (layer.state === "off") return "off: its condition does not hold";
  if (layer.state === "nothing") return "no push";
  const push = `push ${formatNumber(layer.length)}`;
  return layer.cut > 1e-6
    ? `${push}, got ${formatNumber(layer.share)}, ${formatNumber(layer.cut)} was cut`
    : `${push}, got all of it`;
}

function together(e: Explanation): HTMLElement {
  const [before, after] = e.velocity;
  const speed = after ? `; speed ${formatNumber(length(before))} → ${formatNumber(length(after))} mm/s` : "";
  return el("p", { text: `together ${formatNumber(length(e.push))} of 1${speed}` });
}

function length(vector: Triple): number {
  return Math.hypot(...vector);
}
