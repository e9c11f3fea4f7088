"""Checks the declarations of a program, with one file for each kind.

- `species`: params, attributes, latches, handlers, machines and layers, in this order.
- `statements`: the lines of a state or an action.
- `behaviours`: replaces each call of a behaviour by its expansion.
- `world`: things. `fields`: the fields on them.
- `specs`: the expectations about runs."""
