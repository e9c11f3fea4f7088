// Why the selected agent did what it did: the server's explanation of the step to the current frame.

import type { Explained } from "../../protocol";
import type { Store } from "../../store";
import { button, el, setText } from "../dom";
import type { Panel } from "../side";
import { around } from "../why/around";
import { decided } from "../why/decided";
import { layers } from "../why/layers";
import { strips } from "../why/strip";

export const why: Panel = (store, place) => {
  const hint = el("p", {
    class: "note",
    test: "why-hint",
    text: "Click an agent to see what it observed, decided and drew in its last step. By keyboard: tab into the view and press n for the next agent.",
  });
  const title = el("h2", { test: "why-title", "aria-live": "polite" });
  const copy = button("Copy as text", () => void navigator.clipboard?.writeText(store.now.explained?.told ?? ""), {
    class: "small",
  });
  const again = button("Explain", () => ask(store), {
    class: "small",
    title: "explain the step to the current frame",
    test: "explain",
  });
  const about = el("p", { test: "why-about" });
  const head = el("div", { class: "why-head" }, title, again, copy, about);
  const message = el("p", { class: "note bad-note", test: "why-message", hidden: true });
  const body = el("div", { class: "why", test: "why" });
  place.append(hint, head, message, body);
  head.hidden = true;

  let several = "";
  /** The explanation belongs to one frame. If another frame is displayed, dim it and say so. */
  const age = () => {
    const explained = store.now.explained;
    const status = store.now.status;
    if (!explained || !status) return;
    const old = explained.frame !== status.frame;
    body.classList.toggle("old", old);
    const now = old
      ? `, and now it is frame ${status.frame}: ${status.playing ? "pause it, or press Explain" : "it is being updated"}`
      : several;
    setText(about, `the step to frame ${explained.frame}${now}`);
  };
  const show = () => {
    const one = store.now.selected.at(-1);
    const explained = store.now.explained;
    const fits = one && explained && explained.species === one.species && explained.agent === one.id;
    hint.hidden = Boolean(one);
    head.hidden = !one;
    if (!one || !fits) {
      setText(title, one ? `${one.species} ${one.id}` : "");
      setText(about, "its step is simulated again…");
      body.classList.remove("old");
      body.replaceChildren();
      message.hidden = true;
      return;
    }
    const all = store.now.selected.length;
    setText(title, `${one.species} ${one.id}`);
    several = all > 1 ? `; the last of ${all} selected agents` : "";
    age();
    message.hidden = !explained.message;
    setText(message, explained.message);
    fill(store, body, explained);
  };
  store.on(["explained", "selected"], show);
  store.on("status", () => about.textContent?.startsWith("the step") && age());
  requestUpdates(store);
  leadToText(store);
};

function fill(store: Store, body: HTMLElement, explained: Explained): void {
  const { explanation } = explained;
  const focused = body.contains(document.activeElement) ? document.activeElement?.getAttribute("aria-label") : null;
  const top = body.parentElement?.scrollTop ?? 0;
  const open = new Set([...body.querySelectorAll("details[open]")].map((each) => (each as HTMLElement).dataset.name));
  body.replaceChildren(
    ...(explanation
      ? [...strips(store, explanation), ...decided(store, explanation), layers(store, explanation), ...around(store, explanation)]
      : []),
  );
  for (const details of body.querySelectorAll("details")) if (open.has(details.dataset.name)) details.open = true;
  if (focused) [...body.querySelectorAll("button")].find((each) => each.getAttribute("aria-label") === focused)?.focus();
  if (body.parentElement) body.parentElement.scrollTop = top;
}

function ask(store: Store): void {
  const one = store.now.selected.at(-1);
  const status = store.now.status;
  if (one && status) store.connection.ask({ op: "explain", species: one.species, agent: one.id, frame: status.frame });
}

/** Request an explanation of the selected agent whenever play stands still, but not while it plays or the slider is dragged. */
function requestUpdates(store: Store): void {
  let requestedKey = "";
  const renew = (chosen: boolean) => {
    const one = store.now.selected.at(-1);
    const status = store.now.status;
    if (!one || !status) {
      requestedKey = "";
      return;
    }
    if (!chosen && (status.playing || status.light)) return;
    const key = [one.species, one.id, status.frame, status.hash].join(" ");
    if (key === requestedKey) return;
    requestedKey = key;
    ask(store);
  };
  store.on("selected", () => renew(true));
  store.on("status", () => renew(false));
}

/** Mark the line of the executed state change in the text. */
function leadToText(store: Store): void {
  store.on("explained", () => {
    const machines = store.now.explained?.explanation?.machines ?? [];
    const won = machines.flatMap((each) => each.looked).find((each) => each.wins);
    if (won) store.set("goto", { file: won.place.file, line: won.place.line });
  });
}
