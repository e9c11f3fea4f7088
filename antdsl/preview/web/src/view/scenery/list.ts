// The table of packet kinds and their drawing. A new kind is one file and one entry here.

import type { MakeScenery } from "../sight";
import { agents } from "./agents";
import { curves } from "./curves";
import { fields } from "./fields";
import { flows } from "./flows";
import { items } from "./items";
import { meshes } from "./meshes";
import { solids } from "./solids";

export const SCENERY: MakeScenery[] = [meshes, solids, items, fields, flows, curves, agents];
