import type { Store } from "../store";

export function side(store: Store, place: HTMLElement): void {
  store.on("scene", () => (place.textContent = store.now.scene?.name ?? ""));
}
