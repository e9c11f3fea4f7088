"""Analyses that several checks share. They report no findings themselves.

- `check_context`: the input of a check.
- `ranges`: the smallest and largest possible value of an expression.
- `conditions`: whether a condition can hold, and whether it implies another one.
- `timestep_limits`: the limit of a value as the step length goes to 0."""
