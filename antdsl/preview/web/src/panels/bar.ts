// The bar at the top: scene, play controls, speed, current frame, result of the last edit, and state of the run.

import type { Problem } from "../protocol";
import type { Store } from "../store";
import { button, el, setText, formatNumber } from "./dom";
import { watchStatus, listenToKeys, move, playing, toggle } from "./playing";
import { nextTheme, startTheme, themeWords } from "./theme";

const SPEEDS: [number, string][] = [
  [0.1, "0.1 ×"],
  [0.25, "¼ ×"],
  [0.5, "½ ×"],
  [1, "1 ×"],
  [2, "2 ×"],
  [4, "4 ×"],
  [0, "fastest"],
];
const IDLE = "Edit the files in your own editor: after each save, the run continues from this frame.";
const BROKEN = "There are errors. Fix them and save; then it starts by itself.";
const MAX_PAST_MESSAGES = 12; // number of past messages in the tooltip
const REFUSAL_MS = 12_000; // ms for which a refusal stays visible

export function bar(store: Store, place: HTMLElement): void {
  startTheme();
  watchStatus(store);
  listenToKeys(store);
  const above = el("div", { class: "bar-row" }, title(store), controls(store), clock(store), marks(store), themeButton());
  place.append(above, el("div", { class: "bar-row news" }, outcome(store), ...stops(store)));
}

function title(store: Store): HTMLElement {
  const name = el("h1", { class: "scene", test: "scene" });
  store.connection.on("hello", (hello) => {
    if (!store.now.scene) setText(name, hello.scene);
  });
  store.on("scene", () => {
    setText(name, store.now.scene?.name ?? "");
    document.title = `${store.now.scene?.name ?? "antdsl"} · antdsl preview`;
  });
  return name;
}

function controls(store: Store): HTMLElement {
  const play = button("", () => toggle(store), { id: "play", test: "play", class: "play" });
  const back = button("◂", () => move(store, -1), { test: "back", "aria-label": "one frame back", title: "one frame back (,)" });
  const on = button("▸", () => move(store, 1), {
    test: "step",
    "aria-label": "one frame forward",
    title: "one frame forward (.)",
  });
  const speed = el("select", {
    test: "speed",
    "aria-label": "speed",
    title: "speed: 1 × is real time; fastest is as fast as possible",
  });
  for (const [times, words] of SPEEDS) speed.append(el("option", { value: times, text: words }));
  speed.addEventListener("change", () => store.connection.ask({ op: "speed", times: Number(speed.value) }));
  const show = () => {
    const now = playing(store);
    setText(play, now ? "❚❚ pause" : "▶ play");
    play.title = now ? "pause (space)" : "play (space)";
    const times = String(store.now.status?.speed ?? 1);
    if (document.activeElement !== speed && speed.value !== times) {
      if (![...speed.options].some((option) => option.value === times))
        speed.append(el("option", { value: times, text: `${times} ×` }));
      speed.value = times;
    }
  };
  store.on("status", show);
  show();
  return el("div", { class: "controls", role: "group", "aria-label": "Play" }, back, play, on, speed);
}

function clock(store: Store): HTMLElement {
  const frame = el("span", { class: "frame", test: "frame" });
  const seconds = el("span", { class: "quiet", test: "seconds" });
  const rate = el("span", { class: "quiet", test: "rate", title: "simulated frames per second, and the number of agents" });
  store.on(["status", "scene"], () => {
    const status = store.now.status;
    if (!status) return;
    setText(frame, `frame ${status.frame}`);
    const fps = store.now.scene?.fps ?? 0;
    setText(seconds, fps ? `${(status.frame / fps).toFixed(2)} s` : "");
    const agents = `${status.agents.toLocaleString("en")} agent${status.agents === 1 ? "" : "s"}`;
    setText(rate, status.playing ? `${formatNumber(Math.round(status.rate))} frames/s · ${agents}` : agents);
  });
  return el("div", { class: "clock" }, frame, seconds, rate);
}

/** The result of the last edit; screen readers announce it. */
function outcome(store: Store): HTMLElement {
  const line = el("div", { class: "outcome", test: "outcome", role: "status", "aria-live": "polite" });
  let timer = 0;
  const past: string[] = [];
  const display = (words: string, kind: string) => {
    clearTimeout(timer);
    line.className = `outcome ${kind}`;
    line.title = [words, ...past].join("\n");
    setText(line, words);
  };
  /** Display a message with its time. It flashes, even if the text is the same as before. */
  const report = (words: string, kind: string) => {
    const when = `${new Date().toLocaleTimeString("en-GB")}, frame ${store.now.status?.frame ?? 0}`;
    display(words, kind);
    past.unshift(`${when}: ${words}`);
    past.length = Math.min(past.length, MAX_PAST_MESSAGES);
    line.title = past.join("\n");
    line.prepend(el("span", { class: "quiet when", text: `${when}: ` }));
    for (const each of line.getAnimations()) each.cancel();
    line.animate(
      [{ backgroundColor: "color-mix(in srgb, currentColor 45%, transparent)" }, { backgroundColor: "transparent" }],
      1200,
    );
  };
  display(IDLE, "");
  store.on("problems", () => {
    const errors = store.now.problems?.problems.some((each) => each.severity === "error");
    if (!errors || store.now.scene) return;
    display(BROKEN, "bad");
    goToFirst(store, store.now.problems?.problems ?? []);
  });
  store.on("scene", () => line.textContent === BROKEN && display(IDLE, ""));
  store.connection.on("outcome", (message) => {
    const first = message.problems.find((each) => each.severity === "error") ?? message.problems[0];
    if (!message.ok && message.of === "saved") goToFirst(store, message.problems);
    const of = message.of === "saved" ? "saved: " : "";
    if (message.ok) report(of + [message.did, message.line].filter(Boolean).join(" · "), "good");
    else
      report(
        `${of}${message.line || first?.message || "this edit is not possible"}${message.of === "saved" ? " — the last good program continues" : ""}`,
        "bad",
      );
  });
  store.connection.on("refused", (message) => {
    report([message.message, message.help].filter(Boolean).join(" — "), "bad");
    timer = window.setTimeout(() => display(IDLE, ""), REFUSAL_MS);
  });
  return line;
}

/** The reason for a stop: a breakpoint or a faulty value. */
function stops(store: Store): HTMLElement[] {
  const paused = el("span", { class: "chip warn", test: "paused-by", hidden: true, role: "status" });
  const fault = el("span", { class: "chip bad", test: "fault", hidden: true, role: "alert" });
  store.on("status", () => {
    for (const [chip, words] of [
      [fault, store.now.status?.fault],
      [paused, store.now.status?.paused_by],
    ] as const) {
      chip.hidden = !words;
      setText(chip, words ?? "");
      chip.title = words ?? "";
    }
  });
  return [paused, fault];
}

function marks(store: Store): HTMLElement {
  const again = button("simulate again", () => store.connection.ask({ op: "restart" }), {
    test: "restart",
    title: "simulate the current files from the first frame, without edits during the run",
  });
  const edited = el("span", { class: "chip warn edited", test: "edited", hidden: true }, "edited ", again);
  edited.title = "edited during the run: differs from a fresh run";
  const hash = button("", () => void navigator.clipboard?.writeText(store.now.status?.hash ?? ""), {
    test: "hash",
    class: "chip mono",
    hidden: true,
  });
  const count = button("", () => goToFirst(store, store.now.problems?.problems ?? []), {
    test: "errors",
    class: "chip bad",
    hidden: true,
  });
  store.on("status", () => {
    const status = store.now.status;
    edited.hidden = !status?.edited;
    hash.hidden = !status?.hash;
    setText(hash, `# ${status?.hash?.slice(0, 8) ?? ""}`);
    hash.title = `hash of the whole state at frame ${status?.frame}: ${status?.hash} — click to copy`;
  });
  store.on("problems", () => {
    const errors = store.now.problems?.problems.filter((each) => each.severity === "error").length ?? 0;
    count.hidden = errors === 0;
    setText(count, errors === 1 ? "1 error" : `${errors} errors`);
  });
  return el("div", { class: "marks" }, count, edited, hash);
}

function goToFirst(store: Store, problems: readonly Problem[]): void {
  const first = problems.find((each) => each.severity === "error" && each.file !== null);
  if (first?.file) store.set("goto", { file: first.file, line: first.line, mistake: true });
}

function themeButton(): HTMLElement {
  const made = button(
    "◐",
    () => {
      nextTheme();
      made.title = `colours: ${themeWords()}`;
    },
    { test: "theme", "aria-label": "dark or light theme", title: `colours: ${themeWords()}` },
  );
  return made;
}
