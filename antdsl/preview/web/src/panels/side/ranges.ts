// Ranges and steps of sliders.

import type { Param } from "../../protocol";

/** Return the range of a param. If the text gives no range or only one end, propose one that fits the value, with a note. */
export function range(param: Param): { low: number; high: number; offered: string } {
  const base = written(param);
  const size = Math.max(Math.abs(base), Math.abs(param.number)) || 1;
  const low = param.low ?? (base < 0 ? -2 * size : 0);
  const high = param.high ?? Math.max(low, 0) + 2 * size;
  if (param.low !== null && param.high !== null) return { low, high, offered: "" };
  const ends = `${low} to ${high} ${param.unit}`.trimEnd();
  return { low, high, offered: `(The text gives no range: ${ends} is offered.)` };
}

/** Return a step for about two hundred steps: 1, 2 or 5 times a power of ten. */
export function stepOf(low: number, high: number): number {
  const rough = (high - low) / 200;
  if (!(rough > 0)) return 1;
  const ten = 10 ** Math.floor(Math.log10(rough));
  const step = ([1, 2, 5, 10].find((each) => each * ten >= rough * 0.999) ?? 10) * ten;
  return Number(step.toPrecision(6));
}

/** Return the value in the files, in the param's unit. */
export function written(param: Param): number {
  const found = Number.parseFloat(param.written);
  return Number.isFinite(found) ? found : param.number;
}
