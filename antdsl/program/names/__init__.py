"""Resolves names, which is the first half of a check.

- `collect`: reads all files once, and collects their declarations and the behaviours that each file can call.
- `ordering`: puts each declaration after the declarations that it uses.
- `scope`: the names that are visible at a position in the text, and their meanings.
- `missing_things`: suggests how to declare a missing thing of the world."""
