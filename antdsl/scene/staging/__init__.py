"""Conversion of a matched scene to a `Setting`. Files are read; values become mm, seconds and the scene's axes.

`stage_scene`: defines the order: meshes, things, items, flows, crowd.
`stage_things`: reads things that are more than one static file.
`motion`: gives the positions of things at each frame.
`item_placement`: gives the positions of items.
`stage_flows`: gives the data of flows and maps.
`mesh_cache`: stores results about small meshes for reuse."""
