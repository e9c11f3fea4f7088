"""A run on disk: frames, checkpoints, hashes, written so that a crash at any instant leaves one to go on from.

`cache_writer` puts frames in place whole behind a lock (`lock`); `frame_writer` writes them in a thread beside the simulation.
`cache_reader` trusts nothing in a cache before it is held to bounds.
`frames` says what a frame's arrays are, `manifest` what the cache says about itself, `hashes` finds damage, `npz` writes and
reads plain arrays. Solids are kept as what was dug (`solid_pieces`) and dug again to be drawn (`dug_solids`)."""
