"""A run on disk: frames, checkpoints and hashes. After a crash at any instant the run can continue from the cache.

`cache_writer` writes frames atomically behind a lock (`lock`); `frame_writer` writes them in a thread beside the simulation.
`cache_reader` checks everything in a cache against limits before it is used.
`frames` defines a frame's arrays, `manifest` describes the cache, `hashes` finds damage, `npz` writes and reads plain arrays.
Solids are stored as the removed volume (`solid_pieces`) and dug again for drawing (`dug_solids`)."""
