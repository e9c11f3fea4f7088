"""The declarations of a program, checked: one file for each kind.

`species` has the order: params, attributes, latches, handlers, machines, layers. `statements` checks the lines of a state or an
action. `behaviours` expands behaviours in place of their calls. `world` checks things and their fields, `specs` the expectations
of runs."""
