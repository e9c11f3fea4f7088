"""Shots of a sequence and frames of caches as tasks of an executor: the work at the worker (`caches`, `stills`, `exports`), and
the transfer of its files to the requested folder (`placing`)."""
