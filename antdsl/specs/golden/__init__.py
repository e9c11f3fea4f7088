"""Golden runs: the results of a run, stored as text next to its scene and compared with later runs.

`golden_runs` writes and reads the text, which has the `fingerprints` of some frames. They show which attributes differ.
`golden_comparison` decides which run `antdsl test` compares with which recording."""
