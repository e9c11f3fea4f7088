"""Feet of bodies with legs and gaits: footholds of standing feet, and positions of swinging feet.

No other part of a run reads them. Input: the displacements, headings and ground of a step. `feet_step.record_ground_covered`
reads them before the ground moves; `feet_step.step_feet` runs at the end of the step. Output: arrays for each species
(`feet_state.Feet`), which frames and checkpoints store by id. Feet are simulated only if `Options.feet` is set. They are not part
of `state_hash` and have a separate hash.

All loops are kernels, without a second implementation. A step of the feet runs in this order:

- `body_tables` computes positions and axes of bodies.
- `stepping` decides which feet lift and land, and where.
- `foothold_kernels` and `foothold_search` find ground for feet that need it.
- `stepping` moves the trunks (`trunk`) and swings the feet.
- `gaits` computes stride, duty factor and phases by speed."""
