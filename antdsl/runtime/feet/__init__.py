"""Feet of bodies that have legs and gaits: which stand, where, and where the others swing. Nothing else of a run reads them.

In goes what a step did to places, headings and the ground (`walking.measure` before the ground is carried on, `walking.walk` at
its end); out come arrays for each species (`state.Feet`), rows by id, which frames and checkpoints keep. Feet are simulated only
if `Options.feet` is set: they are no part of `state_hash`, and have a hash of their own.

All loops are kernels, and nothing else computes the same. A step of a foot goes through `bodies` (places and axes), `stepping`
(which feet lift and land, and where), `footholds` and `seeking` (ground for those that need some), and `stepping` again, which
moves trunks (`trunk`) and swings feet. `gaits` gives stride, duty and phases by speed."""
