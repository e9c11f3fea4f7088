"""Simulates the feet of bodies with legs and gaits: the footholds of standing feet, and the positions of swinging feet.

No other part of a run reads them. Input: the displacements, headings and ground of a step. `feet_step.record_ground_covered`
reads them before the ground moves; `feet_step.step_feet` runs at the end of the step. Output: arrays for each species
(`feet_state.FeetState`), which frames and checkpoints store by id. Feet are simulated only if `Options.feet` is set. They are
not part of `state_hash` and have a separate hash.

All loops are kernels, without another implementation in NumPy. The modules run in this order in a step:

- `body_tables` computes positions and axes of bodies.
- `stepping` decides which feet lift and land, and where.
- `foothold_kernels` and `foothold_search` find ground for feet that need it.
- `stepping` moves the trunks (`trunk`) and swings the feet.
- `gaits` gives stride, duty factor and phases as functions of speed."""
