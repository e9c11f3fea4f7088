"""A matched scene becomes a `Setting`: files are read, and all is turned to mm, seconds and the scene's axes.

`stage_scene` is the order: meshes, things, items, flows, crowd. `things` reads what is more than one still file, `moves` says
where things are at each frame, `item_placement` where items lie, `flows` what flows and maps are made of. `cached` keeps what
was worked out about small meshes for the next time."""
