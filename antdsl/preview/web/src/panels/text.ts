import type { Store } from "../store";

export function text(store: Store, place: HTMLElement): void {
  store.on("scene", () => (place.textContent = store.now.scene?.name ?? ""));
}
