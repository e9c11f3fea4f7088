"""What a program declares, checked: one file for each kind of declaration.

`species` is the order: params, attributes, latches, handlers, machines, layers. `statements` checks the lines of a state or an
action, `behaviours` puts a behaviour in the place of each of its calls, `world` checks things and the fields on them, `specs`
what a run must show."""
