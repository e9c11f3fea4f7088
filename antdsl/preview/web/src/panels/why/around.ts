// What the agent observed, felt, drew and did, and what changed in it.

import type { Explanation } from "../../explanation";
import type { Store } from "../../store";
import { button, el, formatNumber } from "../dom";
import { folded } from "./parts";

export function around(store: Store, e: Explanation): HTMLElement[] {
  const own = e.changes.filter((each) => !each.memory);
  const memory = e.changes.filter((each) => each.memory);
  const felt = new Map<string, number>();
  for (const each of e.senses) {
    const words = `${each.kind} ${each.name}: ${each.shown}\u0000${each.text}`;
    felt.set(words, (felt.get(words) ?? 0) + 1);
  }
  const parts: [string, number, HTMLElement][] = [
    ["Observed", e.seen.length, el("ul", {}, ...e.seen.map((group) => seen(store, e, group)))],
    ["Fields at its position", e.fields.length, pairs(e.fields.map(([name, value]) => [name, formatNumber(value)]))],
    ["Sensed", felt.size, el("ul", {}, ...[...felt].map(([words, times]) => sense(words, times)))],
    ["Random draws", e.draws.length, pairs(e.draws.map((draw) => [draw.text || draw.site, draw.value.toFixed(6), draw.site]))],
    ["Actions", e.did.length, el("ul", {}, ...e.did.map((each) => el("li", {}, el("code", { text: each }))))],
    ["Changed", own.length, pairs(own.map((each) => [each.name, `${each.shown[0]} → ${each.shown[1]}`]))],
    ["Memory", memory.length, pairs(memory.map((each) => [each.name, `${each.shown[0]} → ${each.shown[1]}`]))],
  ];
  return parts.filter(([, count]) => count > 0).map(([title, count, body]) => folded(title, count, body));
}

function pairs(rows: [string, string, string?][]): HTMLElement {
  return el(
    "dl",
    {},
    ...rows.flatMap(([name, value, title]) => [el("dt", { text: name, title: title ?? name }), el("dd", { text: value })]),
  );
}

function sense(words: string, times: number): HTMLElement {
  const [summary, text] = words.split("\u0000") as [string, string];
  return el("li", { title: text }, summary, times > 1 && el("span", { class: "quiet", text: ` ${times} times` }));
}

/** Return a row for an observed set, with its nearest members. Agents among them can be selected. */
function seen(store: Store, e: Explanation, group: Explanation["seen"][number]): HTMLElement {
  const species = store.now.scene?.species.some((each) => each.name === group.of);
  const near = group.nearest.map((each) => {
    const id = Number(each.name);
    const name =
      species && Number.isInteger(id)
        ? button(each.name, () => store.set("selected", [{ species: group.of, id }]), {
            class: "link",
            title: `select ${group.of} ${each.name}`,
          })
        : el("span", { text: each.name });
    return el(
      "li",
      {},
      name,
      el("span", { class: "quiet", text: ` ${formatNumber(each.distance)} mm${each.about ? ` · ${each.about}` : ""}` }),
    );
  });
  const more = group.count - group.nearest.length;
  if (more > 0) near.push(el("li", { class: "quiet", text: `and ${more} more` }));
  return el(
    "li",
    {},
    el("b", { text: `${group.count} ${group.of}` }),
    " ",
    el("code", { class: "quiet", text: group.asked, title: `${group.asked} — observed by ${e.species}` }),
    el("ul", {}, ...near),
  );
}
