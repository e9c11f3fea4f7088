// Dark, light, or as the system has it; remembered by the browser. `theme` is told to whoever draws on a canvas.

const KEY = "antdsl.theme";
const WORDS = { system: "as the system", dark: "dark", light: "light" } as const;
type Theme = keyof typeof WORDS;

function remembered(): Theme {
  const kept = localStorage.getItem(KEY);
  return kept === "dark" || kept === "light" ? kept : "system";
}

let now: Theme = remembered();

function apply(): void {
  document.documentElement.style.colorScheme = now === "system" ? "dark light" : now;
  document.documentElement.dataset.theme = dark() ? "dark" : "light";
  document.dispatchEvent(new Event("theme"));
}

/** Whether it is dark now, by whatever says so. */
export function dark(): boolean {
  return now === "system" ? matchMedia("(prefers-color-scheme: dark)").matches : now === "dark";
}

export function themeWords(): string {
  return WORDS[now];
}

/** From one to the next: as the system, the other one, this one. */
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
