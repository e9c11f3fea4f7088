"""Conversion of a checked scene to a `Setting`. Files are read, and values are converted to mm, seconds and the scene's axes.

`stage_scene`: defines the order: meshes, things, items, flows, crowd.
`stage_things`: reads things that consist of more than one static file.
`motion`: computes the positions of things at each frame.
`item_placement`: computes the positions of items.
`stage_flows`: reads flows and maps.
`mesh_cache`: stores results about small meshes for reuse."""
