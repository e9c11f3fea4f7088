"""Settles a cache with edits: simulates again the agents that the edits disturb. An agent is disturbed if edits make it overlap
another, or remove an agent that it touched.

Input: a cache with edits, and the shot that wrote the cache. Output: the new frames of these agents, which
`outputs.edits.settled_layer` shows above the edits. `affected` finds the agents and the first frame in which each is disturbed.
`resimulation` then steps a world from the checkpoint before it. `scripted_agents` places all other agents as in the cache."""
