// Clicks: a click selects the agent at the pointer; with shift it adds or removes the agent. A click beside all agents clears the
// selection. Dragging with shift selects all agents within a box. While a panel waits for a place, a click gives it one.

import type { Agent } from "../../store";
import { onScreen, pick, pickPlace } from "../picking";
import type { Sight } from "../sight";

const STILL = 5; // px that the pointer may move during a click

export function pointer(sight: Sight): void {
  const { stage, store, eye } = sight;
  const { canvas } = stage;
  let down: { x: number; y: number; box: boolean } | null = null;
  const frame = document.createElement("div");
  frame.className = "sight-box";
  frame.hidden = true;
  stage.place.append(frame);

  canvas.addEventListener(
    "pointerdown",
    (event) => {
      if (event.button !== 0) return;
      down = { x: event.offsetX, y: event.offsetY, box: event.shiftKey };
      eye.rest(event.shiftKey);
    },
    { capture: true },
  );

  canvas.addEventListener("pointermove", (event) => {
    if (!down?.box) return;
    frame.hidden = false;
    frame.style.left = `${Math.min(down.x, event.offsetX)}px`;
    frame.style.top = `${Math.min(down.y, event.offsetY)}px`;
    frame.style.width = `${Math.abs(down.x - event.offsetX)}px`;
    frame.style.height = `${Math.abs(down.y - event.offsetY)}px`;
  });

  function up(event: PointerEvent): void {
    const from = down;
    down = null;
    frame.hidden = true;
    eye.rest(false);
    if (!from || event.type === "pointercancel") return;
    if (Math.hypot(event.offsetX - from.x, event.offsetY - from.y) <= STILL) click(event);
    else if (from.box) store.set("selected", within(from.x, from.y, event.offsetX, event.offsetY));
  }
  canvas.addEventListener("pointerup", up);
  canvas.addEventListener("pointercancel", up);
  store.on("picking", () => stage.place.classList.toggle("picking", store.now.picking !== null));

  function click(event: PointerEvent): void {
    if (store.now.picking) {
      store.now.picking.pick(pickPlace(sight, event.offsetX, event.offsetY, store.now.picking));
      return;
    }
    const found = pick(sight, event.offsetX, event.offsetY);
    if (!event.shiftKey) {
      store.set("selected", found ? [found] : []);
      return;
    }
    if (!found) return;
    const others = store.now.selected.filter((each) => each.species !== found.species || each.id !== found.id);
    store.set("selected", others.length < store.now.selected.length ? others : [...others, found]);
  }

  function within(x: number, y: number, x2: number, y2: number): Agent[] {
    const found: Agent[] = [];
    for (const [species, herd] of sight.herds.byName) {
      for (let row = 0; row < herd.count; row++) {
        const agent = { species, id: herd.ids[row] as number };
        const at = onScreen(sight, agent);
        if (at && (at[0] - x) * (at[0] - x2) <= 0 && (at[1] - y) * (at[1] - y2) <= 0) found.push(agent);
      }
    }
    return found;
  }
}
