"""Shots of a sequence and frames of caches as tasks of an executor: what is done where they run (`caches`, `stills`,
`exports`), and how the
files that they make come to the folder that was named (`placing`)."""
