import type { Store } from "../store";

export function view(store: Store, place: HTMLElement): void {
  store.connection.onPacket((packet) => (place.dataset.slot = packet.slot));
}
