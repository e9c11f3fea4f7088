"""Golden runs: the results of a run, stored as text beside its scene and compared with later runs.

`golden_runs` writes and reads the text. It contains the `fingerprints` of each frame, which show the attributes that differ.
`golden_comparison` decides which run `antdsl test` compares with which recording."""
