"""Analyses that several checks share. None of them reports findings.

- `check_context`: the input of a check.
- `ranges`: the smallest and largest possible value of an expression.
- `conditions`: comparison of conditions.
- `timestep_limits`: the limit of a value as the step length goes to 0."""
