"""Settles a cache with edits: simulates again the agents that edits made overlap, or that touched agents which edits took away.

Input: a cache with edits, and the shot that wrote it. Output: the frames of these agents, which `outputs.edits.settled_layer`
shows above the edits. Order: `affected` finds the agents and their first frames, on which the nearest checkpoint depends; then
`resimulation` steps a world from that checkpoint, in which `scripted_agents` puts all other agents where the cache has them."""
