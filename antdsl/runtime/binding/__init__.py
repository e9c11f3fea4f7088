"""A plan and a setting become a world at its first frame.

`bind_world` is the order: meshes become ground and ray scenes, things and curves are taken over, `fields` and `flows` get their
cells and points, agents are placed (`placing`, by places that `start_places` draws and `spacing` keeps apart, over the areas of
`surface_area`), registers get their values of birth. `reuse` keeps what was made of
meshes for the next world. Nothing here runs during a step."""
