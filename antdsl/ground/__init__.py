"""What agents stand on: meshes, meshes that move, solids that can be dug, all of them together, or an endless plane.

The runtime sees one door, a ground: where are these footings, which way is up there, and where does a step lead. `mesh` walks
over triangles, `moving` has meshes that move between steps, `solid` is a signed distance that can be dug, `combined` joins
meshes and solids, `plane` is the ground of a scene without surfaces, and `sticking` follows any surface by two rays a step. A
footing is a row of one table, whatever it stands on (`footing_table`). Places and lengths are in mm, in the scene's axes."""
