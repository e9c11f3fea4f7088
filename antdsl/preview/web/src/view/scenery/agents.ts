// `rig:KEY`: the bodies of agents. Frames contain their positions and clips.

import type { Scenery, Sight } from "../sight";

export function agents({ bodies }: Sight): Scenery {
  return { slots: ["rig"], take: (packet) => bodies.take(packet) };
}
