// The colour theme: dark, light, or the system's. The browser stores it; a `theme` event informs canvases of a change.

const KEY = "antdsl.theme";
const WORDS = { system: "same as the system", dark: "dark", light: "light" } as const;
type Theme = keyof typeof WORDS;

function readStored(): Theme {
  const stored = localStorage.getItem(KEY);
  return stored === "dark" || stored === "light" ? stored : "system";
}

let now: Theme = readStored();

function apply(): void {
  document.documentElement.style.colorScheme = now === "system" ? "dark light" : now;
  document.documentElement.dataset.theme = dark() ? "dark" : "light";
  document.dispatchEvent(new Event("theme"));
}

/** Return whether the theme is dark now. */
export function dark(): boolean {
  return now === "system" ? matchMedia("(prefers-color-scheme: dark)").matches : now === "dark";
}

export function themeWords(): string {
  return WORDS[now];
}

/** Switch to the next theme: system, then the other one, then the same as the system's. */
export function nextTheme(): void {
  const order: Theme[] = matchMedia("(prefers-color-scheme: dark)").matches
    ? ["system", "light", "dark"]
    : ["system", "dark", "light"];
  now = order[(order.indexOf(now) + 1) % order.length] as Theme;
  localStorage.setItem(KEY, now);
  apply();
}

export function startTheme(): void {
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", apply);
  apply();
}
