"""Feet of bodies with legs and gaits: which feet stand, where, and where the others swing. No other part of a run reads them.

Input: the displacements, headings and ground of a step. `walking.measure` reads them before the ground moves on, `walking.walk`
at the end of the step. Output: arrays for each species (`state.Feet`), which frames and checkpoints store by id. Feet are
simulated only if `Options.feet` is set: they are not part of `state_hash` and have a separate hash.

All loops are kernels, without a second implementation. A step of a foot uses `bodies` (positions and axes), `stepping` (which
feet lift and land, and where), and `footholds` and `seeking` (ground for feet that need it). Then `stepping` moves trunks
(`trunk`) and swings feet. `gaits` gives stride, duty factor and phases by speed."""
