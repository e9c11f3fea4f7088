// The functions of the view besides the drawing of packets. A new one is one file and one entry here.

import type { Act } from "../sight";
import { feelers } from "./feelers";
import { forces } from "./forces";
import { hook } from "./hook";
import { keys } from "./keys";
import { legend } from "./legend";
import { marks } from "./marks";
import { paths } from "./paths";
import { pointer } from "./pointer";
import { scales } from "./scales";
import { trails } from "./trails";

export const ACTS: Act[] = [marks, trails, paths, feelers, forces, legend, scales, pointer, keys, hook];
