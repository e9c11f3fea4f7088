// Values that can change during the run: params, layers, fields; and the lines for them, to be copied into the files.

import type { Param } from "../../protocol";
import type { Store } from "../../store";
import { button, el, keyed, type Row, setText, throttled } from "../dom";
import type { Panel } from "../side";
import { Lines } from "./lines";
import { range, stepOf, written } from "./ranges";
import { switches } from "./switches";

const EVERY = 100; // ms between two values while a slider is dragged

export const sliders: Panel = (store, place) => {
  const list = el("div", { class: "params", test: "params" });
  const none = el("p", {
    class: "note",
    text: "The program has no `param`. Write one, such as `param swing = 50 deg in 0 deg .. 180 deg`, and it appears here.",
  });
  const rows = keyed<Param>(list, paramKey, () => paramRow(store));
  const lines = new Lines(store);
  place.append(none, list, ...switches(store), lines.element);
  store.on("scene", () => {
    const params = store.now.scene?.params ?? [];
    none.hidden = params.length > 0;
    rows(params);
  });
};

function paramKey(param: Param): string {
  return [param.name, param.unit, param.low, param.high].join("\u0000");
}

function paramRow(store: Store): Row<Param> {
  let now: Param | null = null;
  const name = el("button", { type: "button", class: "name" });
  const help = el("p", { class: "help" });
  const slider = el("input", { type: "range" });
  const field = el("input", { type: "number", class: "number" });
  const unit = el("span", { class: "unit" });
  const back = button("↺", () => now && send(written(now)), { class: "small" });
  let sent: string | null = null; // the last value sent, until a scene confirms it
  const ask = throttled(EVERY, (value: string) => now && store.connection.ask({ op: "set", name: now.name, value }));

  const send = (value: number) => {
    if (!now || !Number.isFinite(value)) return;
    slider.value = String(value);
    if (document.activeElement !== field) field.value = String(value);
    slider.setAttribute("aria-valuetext", `${value} ${now.unit}`.trim());
    sent = `${value} ${now.unit}`.trim();
    back.disabled = value === written(now);
    ask(sent);
  };
  name.addEventListener("click", () => now && store.set("goto", { file: now.file, line: now.line }));
  slider.addEventListener("input", () => send(Number(slider.value)));
  field.addEventListener("change", () => field.value !== "" && send(Number(field.value)));

  const element = el("div", { class: "param" }, name, el("span", { class: "controls" }, field, unit, back), slider, help);
  return {
    element,
    update: (param) => {
      const fresh = now === null;
      now = param;
      const { low, high, offered } = range(param);
      if (fresh) {
        for (const input of [slider, field]) {
          input.step = input === slider ? String(stepOf(low, high)) : "any";
          input.setAttribute("aria-label", [param.name, param.unit && `in ${param.unit}`].filter(Boolean).join(", "));
        }
        if (param.low !== null) field.min = String(param.low);
        if (param.high !== null) field.max = String(param.high);
        slider.min = String(low);
        slider.max = String(high);
        element.dataset.param = param.name;
        slider.dataset.test = `param-${param.name}`;
      }
      setText(name, param.name);
      name.title = `${param.name} — go to where it is written, ${param.file}:${param.line}`;
      setText(unit, param.unit);
      setText(help, [param.help, offered].filter(Boolean).join(" "));
      help.hidden = !help.textContent;
      const answered =
        sent === null ||
        sent === param.value ||
        Math.abs(Number.parseFloat(sent) - param.number) <= 1e-6 * Math.abs(param.number);
      if (answered) sent = null;
      if (answered && !slider.matches(":active")) {
        slider.value = String(param.number);
        if (document.activeElement !== field) field.value = String(Number(param.number.toPrecision(6)));
        slider.setAttribute("aria-valuetext", param.value);
      }
      back.title = `back to ${param.written}, as the files have it`;
      back.setAttribute("aria-label", `${param.name} back to ${param.written}`);
      back.disabled = Math.abs(param.number - written(param)) <= 1e-9 * Math.abs(param.number);
    },
  };
}
