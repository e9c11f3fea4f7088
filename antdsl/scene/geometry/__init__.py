"""Readers that convert geometry files to arrays: meshes, points and painted values. The content of a file is never trusted.

Counts in a file are compared with the size of the file before anything is allocated. Readers from other libraries only receive
files that have been checked.

`mesh_files`: chooses a reader by the file's extension: `obj_file`, `ply` and `ply_body`, `stl_file`, `gltf_mesh` or `usd`.
`mesh_text`: splits text files into words.
`polygons`: triangulates the polygons of all formats.
`import_notes`: reports what a reader omitted and changed.
`points`, `arrays`: read JSON points and .npz files.
`painted`: reads values on vertices and faces.
`closed_meshes`: checks whether triangles form a closed body.
`find_faces_with_area`: finds the triangles that are ground.
`matrices`: applies transforms, with every sum written out."""
