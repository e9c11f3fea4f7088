// How values of fields become colour: a fixed scale of powers of ten, so that a frame looks the same whatever was played before.

import type { Shared } from "../store";

/** A byte of a packet: 1 is ten to the power of LEAST, 255 is DECADES powers more. */
export const [LEAST, DECADES] = [-8, 16];
/** Powers of ten from where colour begins to where it is full. */
export const SHOWN = 5;

/** Where a field's colours end: as somebody chose it, else as the server proposes: its limit, or 100. */
export function fullOf(now: Shared, name: string): number {
  return now.full[name] ?? now.scene?.fields.find((field) => field.name === name)?.full ?? 100;
}

/** The share of the whole scale at which a value stands, 0 to 1. */
export function level(value: number, full: number): number {
  return value > 0 ? Math.min(Math.max(1 + (Math.log10(value) - Math.log10(full)) / SHOWN, 0), 1) : 0;
}
