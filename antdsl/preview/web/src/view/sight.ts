// What the parts of the view share, and the two kinds of parts: parts that draw packets of some slots, and independent parts.

import type { Packet } from "../protocol";
import type { Store } from "../store";
import type { Bodies } from "./bodies/bodies";
import type { Eye } from "./eye";
import type { Herds } from "./herds/herds";
import type { Stage } from "./stage";

export interface Sight {
  store: Store;
  stage: Stage;
  herds: Herds;
  bodies: Bodies;
  eye: Eye;
}

/** Draws the packets of a slot; `slot` is the part of the slot's name before the first colon. */
export interface Scenery {
  slots: string[];
  take(packet: Packet): void;
}

export type MakeScenery = (sight: Sight) => Scenery;
export type Act = (sight: Sight) => void;
