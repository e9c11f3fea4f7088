"""Makes a world at its first frame from a plan and a setting.

`bind_world` calls the other modules in order. It makes the ground and ray scenes from meshes, and adds things and curves.
    `bind_fields` and `bind_flows` make cells of fields and points of flows. `agent_placement` places agents, at positions that
    `start_positions` draws, `surface_area` spreads over surfaces, and `spacing` keeps clear of each other. Registers then get
    their birth values. `binding_cache` caches data made from meshes for the next world. Nothing here runs during a step."""
