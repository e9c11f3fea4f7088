"""Golden runs: what a run came to, kept as text beside its scene, and held against later runs.

`recorded` writes and reads the text, made of the `fingerprints` of each frame, which tell what differs, attribute by attribute.
`comparing` decides in one `antdsl test` which run is held against which."""
