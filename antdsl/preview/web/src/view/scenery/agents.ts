// `body:NAME` and `rig:SPECIES`: what agents look like. Where they are, and what they play, comes with frames.

import type { Scenery, Sight } from "../sight";

export function agents({ bodies }: Sight): Scenery {
  return {
    slots: ["body", "rig"],
    take: (packet) => (packet.slot.startsWith("rig:") ? bodies.takeRig(packet) : bodies.take(packet)),
  };
}
