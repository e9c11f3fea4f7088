// How field values become colours: a fixed logarithmic scale, so that the same frame always has the same colours.

import type { Shared } from "../store";

/** Bytes of a packet: 1 is ten to the power of LEAST, 255 is DECADES powers more. */
export const [LEAST, DECADES] = [-8, 16];
/** Powers of ten from the first colour to full colour. */
export const SHOWN = 5;

/** Return the value of full colour of a field: the user's choice, else the server's proposal, which is the limit or 100. */
export function fullOf(now: Shared, name: string): number {
  return now.full[name] ?? now.scene?.fields.find((field) => field.name === name)?.full ?? 100;
}

/** Return the position of a value on the whole scale, 0 to 1. */
export function level(value: number, full: number): number {
  return value > 0 ? Math.min(Math.max(1 + (Math.log10(value) - Math.log10(full)) / SHOWN, 0), 1) : 0;
}
