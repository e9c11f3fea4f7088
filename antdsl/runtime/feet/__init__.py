"""Feet of bodies that have legs and gaits: which stand, where, and where the others swing. Nothing else of a run reads them.

In goes what a step did to places, headings and the ground (`walking.measure` before the ground is carried on, `walking.walk` at
its end); out come arrays for each species (`state.Feet`), rows by id, which frames and checkpoints keep. `gaits` gives stride,
duty and phases by speed, `seeking` finds ground for a foot, `trunk` the height and the tilt of the body. Feet are worked out only
where `Options.feet` says so: they are no part of `state_hash`, and have a hash of their own."""
