"""Shots and frames of caches as tasks of an executor.

`caches`, `stills` and `exports` do the work on a worker. `task_destination` brings the written files to the requested folder."""
