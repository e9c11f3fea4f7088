// The state changes that the program checked, in order: the condition of each with values, and which one won.

import type { Explanation, Looked } from "../../explanation";
import type { Store } from "../../store";
import { el, formatNumber } from "../dom";
import { conditionParts, link, section } from "./parts";

type Machine = Explanation["machines"][number];

export function decided(store: Store, e: Explanation): HTMLElement[] {
  const notes = e.notes.length ? [el("p", { class: "note", text: e.notes.join(" ") })] : [];
  const machines = e.machines.map((machine) =>
    section(headline(machine, e.machines.length > 1), changes(store, machine), claim(store, machine), choice(machine)),
  );
  const events = e.handlers.length ? [section("Events", ...e.handlers.map((each) => link(store, each)))] : [];
  return [...notes, ...machines, ...events];
}

function headline(m: Machine, several: boolean): string {
  const name = several ? `${m.machine}: ` : "";
  if (m.changed || m.before !== m.after) return `${name}${m.before} → ${m.after}, after ${formatNumber(m.since)} s`;
  return `${name}stays in ${m.after}, for ${formatNumber(m.since)} s so far`;
}

function changes(store: Store, m: Machine): HTMLElement {
  if (!m.looked.length) return el("p", { class: "note", text: "This state has no transitions." });
  let won = false;
  const rows = m.looked.map((each) => {
    const row = looked(store, each, won);
    won ||= each.wins;
    return row;
  });
  return el("ol", { class: "looked", test: "looked" }, ...rows);
}

function looked(store: Store, each: Looked, won: boolean): HTMLElement {
  const verdict = each.wins ? "wins" : each.fires ? (won ? "holds too" : "holds") : "no";
  const row = el(
    "li",
    { class: each.wins ? "wins" : each.fires ? "holds" : "no" },
    el("span", { class: "verdict", text: verdict }),
    link(store, each.place),
  );
  if (each.condition) {
    const parts = conditionParts(each.condition, each.timers.length > 0);
    if (parts) row.append(parts);
  }
  for (const timer of each.timers) row.append(timerRow(timer));
  if (each.take) row.append(el("p", { class: "quiet", text: `from: ${each.take.shown}` }));
  return row;
}

function timerRow(timer: Looked["timers"][number]): HTMLElement {
  const meter = el("span", { class: `timer ${timer.holds ? "yes" : ""}` });
  meter.style.setProperty("--share", `${Math.min(1, timer.needs > 0 ? timer.has / timer.needs : 1) * 100}%`);
  return el(
    "p",
    { class: "timed" },
    el("code", { text: timer.what }),
    meter,
    el("span", { text: `${formatNumber(timer.has)} of ${formatNumber(timer.needs)} ${timer.unit}` }),
  );
}

function claim(store: Store, { claim: request }: Machine): HTMLElement | null {
  if (!request) return null;
  const much = request.amount === null ? "all" : formatNumber(request.amount);
  const words = request.won ? "received" : "not received: others came first, or there was not enough";
  return el(
    "p",
    { class: "claim", test: "claim" },
    el("b", { class: request.won ? "yes" : "no", text: words }),
    ` — ${[much, request.attribute, "of", request.item].filter(Boolean).join(" ")}, turn ${formatNumber(request.draw)} `,
    link(store, request.place),
  );
}

function choice({ choice: drawn }: Machine): HTMLElement | null {
  if (!drawn) return null;
  const bar = el("div", { class: "choice" });
  let from = 0;
  for (const [name, to] of drawn.bars) {
    const piece = el("span", {
      class: name === drawn.chosen ? "yes" : "",
      text: name,
      title: `${name}: from ${formatNumber(from)} to ${formatNumber(to)}`,
    });
    piece.style.width = `${(to - from) * 100}%`;
    bar.append(piece);
    from = to;
  }
  const needle = el("i");
  needle.style.left = `${drawn.draw * 100}%`;
  bar.append(needle);
  return el("div", {}, el("p", { text: `drew ${formatNumber(drawn.draw)}: ${drawn.chosen}` }), bar);
}
