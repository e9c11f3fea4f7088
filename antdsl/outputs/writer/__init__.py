"""Writing in a thread beside the simulation.

`background` does work in order in that thread, `frame_writer` is what it does: frames and checkpoints into files, and what is
known of them. It is handed arrays that nobody changes any more, so that nothing is copied; checksums and writing leave
the interpreter to the simulation. `process_memory` tells how much memory a process has used."""
