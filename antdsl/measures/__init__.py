"""Numbers and conditions about complete runs. They are evaluated with a plan from `plan/lowering/spec_blocks.py` and a World.

`evaluator` reads values of agents, items and fields in each frame, and `aggregates` reduces these to one number. `conditions`
compiles a condition that is not part of a program. `run_measures` evaluates the measures of a program, and decides when a run
ends. Specs use the same evaluator. `check` imports only `scene_measures`, which needs no arrays."""
