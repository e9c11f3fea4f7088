"""Evaluates numbers and conditions about complete runs: a plan of `plan/lowering/spec_blocks.py` and a World give values.

`evaluator` reads values of agents, items and fields in each frame, and `aggregates` reduces them to one number. `conditions`
compiles a condition that is not in a program. `run_measures` has the measures of a program, and decides when a run ends. Specs
use the same evaluator. `check` imports `scene_measures` only, which needs no arrays."""
