"""A run on disk: frames, checkpoints and hashes. After a crash at any time, the run can continue from its cache.

`cache_writer` writes frames atomically behind a lock (`lock`). `frame_writer` writes frames in a background thread, while the
simulation continues. `cache_reader` checks everything in a cache against limits before it is used. `frame_maker` defines the
arrays of a frame, `manifest` describes the cache, `hashes` finds damage. `npz` writes and reads plain arrays. `solid_pieces`
stores what is dug out of solids; `dug_solids` digs it out again for drawing."""
