"""Analyses that several checks share. None of them reports findings.

- `checked`: the input of a check.
- `ranges`: the smallest and largest possible value of an expression.
- `conditions`: comparison of conditions.
- `short_steps`: the limit of a value as the step length goes to 0."""
