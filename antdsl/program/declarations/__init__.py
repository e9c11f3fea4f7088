"""Checks the declarations of a program. Each kind of declaration has its own file.

- `species`: params, attributes, latches, handlers, machines and layers, in this order.
- `statements`: the lines of a state or an action.
- `behaviours`: behaviours and the expansion of their calls.
- `world`: things. `fields`: the fields on them.
- `specs`: the expectations about runs."""
