"""Settles an edited cache: agents that the edits disturb are simulated again. An agent is disturbed if edits make it overlap
another agent, or remove an agent that it touched. Input: a cache with edits, and the shot that wrote the cache. Output: the
new frames of these agents, which `outputs.edits.settled_layer` shows above the edits. `affected` finds the disturbed agents,
with the first frame in which each is disturbed. `resimulation` then steps a world from the last checkpoint before this frame.
`scripted_agents` places all other agents as in the cache."""
