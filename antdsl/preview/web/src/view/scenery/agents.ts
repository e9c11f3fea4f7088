// `rig:KEY`: what agents look like. Where they are, and what they play, comes with frames.

import type { Scenery, Sight } from "../sight";

export function agents({ bodies }: Sight): Scenery {
  return { slots: ["rig"], take: (packet) => bodies.take(packet) };
}
