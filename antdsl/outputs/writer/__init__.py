"""Writing in a process of its own beside the simulation.

`background` runs work in order in a process that was forked off, `shared_memory` hands it the arrays of a state,
`frame_writer` is what it does with each: measure, hash, make a frame, write it. `memory` tells how much memory a process has
used."""
