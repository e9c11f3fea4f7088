// The text in the view while nothing can be displayed: first fix the errors.

import type { Store } from "../store";
import { shortName } from "../panels/text/files";

const MOST = 3;

export function nothing(store: Store, place: HTMLElement): void {
  const box = document.createElement("div");
  box.className = "sight-nothing";
  box.dataset.test = "nothing";
  box.setAttribute("role", "status");
  box.hidden = true;
  place.append(box);

  function renew(): void {
    const errors = (store.now.problems?.problems ?? []).filter((each) => each.severity === "error");
    box.hidden = store.now.scene !== null || errors.length === 0;
    if (box.hidden) return;
    const title = document.createElement("h2");
    title.textContent =
      errors.length === 1 ? "Nothing to display: there is an error" : `Nothing to display: there are ${errors.length} errors`;
    const rows = errors.slice(0, MOST).map((each) => {
      const row = document.createElement("button");
      row.type = "button";
      const where = each.file === null ? "" : `${shortName(each.file)}:${each.line} `;
      row.textContent = `${where}${each.message}${each.help ? ` — ${each.help}` : ""}`;
      row.addEventListener(
        "click",
        () => each.file !== null && store.set("goto", { file: each.file, line: each.line, mistake: true }),
      );
      return row;
    });
    const words = document.createElement("p");
    words.textContent = "Fix them in your editor and save. Then it starts by itself.";
    box.replaceChildren(title, ...rows, words);
  }

  store.on(["problems", "scene"], renew);
}
