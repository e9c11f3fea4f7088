"""Golden runs: results of runs that are stored as text next to the scene, for comparison with later runs.

`golden_runs` writes and reads the text, which contains the `fingerprints` of some frames. These show which attributes differ.
`golden_comparison` decides which run `antdsl test` compares with which recording."""
