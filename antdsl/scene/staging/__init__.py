"""A matched scene becomes a `Setting`: files are read, and all values are converted to mm, seconds and the scene's axes.

`stage_scene` defines the order: meshes, things, items, flows, crowd. `things` reads what is more than one static file, `moves`
gives the positions of things at each frame. `item_placement` gives positions of items, `flows` the data of flows and maps.
`cached` stores results about small meshes for reuse."""
