"""Analyses that several checks share.

`checked` is the input of a check. `ranges` bounds values, `conditions` compares conditions, and `short_steps` finds the limit of
a value as steps get shorter. None of them reports findings."""
