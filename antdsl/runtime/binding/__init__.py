"""Creates a world at its first frame from a plan and a setting.

`bind_world` calls the other modules in order. It makes the ground and ray scenes from meshes, and adds things and curves.
`bind_fields` and `bind_flows` make cells of fields and points of flows. `agent_placement` places agents: `start_positions`
draws positions, `surface_area` spreads them over surfaces, and `spacing` avoids overlaps. Then the registers receive their
values at birth. `binding_cache` caches data made from meshes for the next world. No code of this package runs during a step."""
