// Switches for layers and fields during the run.

import type { LayerInfo } from "../../protocol";
import type { Store } from "../../store";
import { css, el, keyed, type Row, setText } from "../dom";

interface Layer extends LayerInfo {
  species: string;
}
interface Field {
  name: string;
  unit: string;
  colour: [number, number, number];
  on: boolean;
}

export function switches(store: Store): HTMLElement[] {
  const layerList = el("ul", { class: "switches", test: "layers" });
  const fieldList = el("ul", { class: "switches", test: "fields" });
  const layers = el("section", {}, el("h3", { text: "Layers, the first wins" }), layerList);
  const fields = el("section", {}, el("h3", { text: "Fields that hold scent" }), fieldList);
  const layerRows = keyed<Layer>(
    layerList,
    (layer) => `${layer.species}\u0000${layer.text}`,
    () => layerRow(store),
  );
  const fieldRows = keyed<Field>(
    fieldList,
    (field) => field.name,
    () => fieldRow(store),
  );
  store.on("scene", () => {
    const scene = store.now.scene;
    const all = scene?.species.flatMap((each) => each.layers.map((layer) => ({ ...layer, species: each.name }))) ?? [];
    layers.hidden = all.length === 0;
    fields.hidden = !scene?.fields.length;
    layerRows(all);
    fieldRows(scene?.fields ?? []);
  });
  return [layers, fields];
}

function layerRow(store: Store): Row<Layer> {
  let now: Layer | null = null;
  const box = el("input", { type: "checkbox" });
  const words = el("code");
  const label = el("label", {}, box, words);
  box.addEventListener(
    "change",
    () => now && store.connection.ask({ op: "layer", species: now.species, layer: now.text, on: box.checked }),
  );
  const go = el("button", {
    type: "button",
    class: "link",
    on: { click: () => now && store.set("goto", { file: now.file, line: now.line }) },
  });
  return {
    element: el("li", {}, label, go),
    update: (layer) => {
      now = layer;
      box.checked = layer.on;
      setText(words, layer.text);
      words.title = `${layer.text} — of ${layer.species}`;
      setText(go, `:${layer.line}`);
      go.setAttribute("aria-label", `go to line ${layer.line}`);
    },
  };
}

function fieldRow(store: Store): Row<Field> {
  let now: Field | null = null;
  const box = el("input", { type: "checkbox" });
  const swatch = el("span", { class: "swatch" });
  const words = el("span");
  box.addEventListener("change", () => now && store.connection.ask({ op: "field", name: now.name, on: box.checked }));
  return {
    element: el("li", {}, el("label", {}, box, swatch, words)),
    update: (field) => {
      now = field;
      box.checked = field.on;
      swatch.style.background = css(field.colour);
      setText(words, field.name);
    },
  };
}
