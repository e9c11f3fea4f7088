"""Contacts between bodies.

`contact_solver` separates overlapping bodies after all species have walked. `capsules` and `capsule_distances` measure pairs,
`loads` extends capsules by loads, `step_clamping` shortens steps into other agents, and `separation` separates pairs.
`long_steps` and `impacts` stop agents with long steps before they pass through others. `step_retreats` undoes steps after
which bodies still overlap. `body_contacts` shifts bodies out of triangles."""
