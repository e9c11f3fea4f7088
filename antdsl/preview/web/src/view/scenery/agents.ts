// `body:NAME`: what agents look like. Where they are comes with frames.

import type { Scenery, Sight } from "../sight";

export function agents(sight: Sight): Scenery {
  return { slots: ["body"], take: (packet) => sight.bodies.take(packet) };
}
