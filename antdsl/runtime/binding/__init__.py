"""Creates a world at its first frame from a plan and a setting.

`bind_world` calls the other modules in order. It makes the ground and the ray scenes from meshes, and adds things and curves.
`bind_fields` and `bind_flows` make the cells of fields and the points of flows. `agent_placement` places agents:
`start_positions` draws positions, `surface_area` spreads them over surfaces, and `spacing` avoids overlaps. Then the agents'
registers get their values at birth. `binding_cache` retains data made from meshes for the next world. `releases` creates agents
during the run."""
