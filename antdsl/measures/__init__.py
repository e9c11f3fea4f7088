"""Evaluates numbers and conditions about complete runs. Their values come from a plan of `plan/lowering/spec_blocks.py` and a
World.

`evaluator` reads values of agents, items and fields in each frame, and `aggregates` reduces them to one number. `conditions`
compiles a condition that is not in a program. `run_measures` evaluates the measures of a program, and decides when a run ends.
Specs use the same evaluator. `check` imports only `scene_measures`, which needs no arrays."""
