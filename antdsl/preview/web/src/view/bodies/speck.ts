// A simple body for crowds on slow machines: eight faces, pointed in front, as long and wide as the body it represents.

import type { Shape } from "./shapes";

const CORNERS = [
  [1, 0, 0],
  [-1, 0.15, 0],
  [-0.35, 0, 1],
  [-0.35, 0, -1],
  [-0.3, 1, 0],
  [-0.3, -0.4, 0],
] as const;
const FACES = [0, 4, 2, 0, 3, 4, 1, 2, 4, 1, 4, 3, 0, 2, 5, 0, 5, 3, 1, 5, 2, 1, 3, 5];

/** Return the positions of a body's trunk only: legs do not widen the speck. */
export function speck(places: Float32Array): Shape {
  const low = new Array<number>(3).fill(Number.POSITIVE_INFINITY);
  const high = new Array<number>(3).fill(Number.NEGATIVE_INFINITY);
  for (let k = 0; k < places.length; k++) {
    const axis = k % 3;
    low[axis] = Math.min(low[axis] as number, places[k] as number);
    high[axis] = Math.max(high[axis] as number, places[k] as number);
  }
  const position = new Float32Array(CORNERS.length * 3);
  const normal = new Float32Array(CORNERS.length * 3);
  CORNERS.forEach((corner, row) => {
    corner.forEach((part, axis) => {
      const middle = ((low[axis] as number) + (high[axis] as number)) / 2;
      const half = ((high[axis] as number) - (low[axis] as number)) / 2;
      position[3 * row + axis] = middle + part * half * (axis === 2 ? 1.25 : 1);
      normal[3 * row + axis] = part / Math.hypot(...corner);
    });
  });
  return { position, normal, face: Uint32Array.from(FACES) };
}
