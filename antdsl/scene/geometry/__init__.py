"""Readers of geometry files to arrays: meshes, points and painted values. No content of a file is trusted.

Counts in a file are compared with its size before anything is allocated. Readers of other libraries only get files that were
checked first.

`mesh_files`: chooses a reader by the ending of the file: `obj_file`, `ply` and `ply_body`, `stl_file`, `gltf_mesh` or `usd`.
`mesh_text`: the tokenizer of text files.
`polygons`: the triangulation for all formats.
`import_notes`: the report of a reader's omissions and changes.
`points`, `arrays`: read JSON points and .npz files.
`painted`: reads values on vertices and faces.
`closed_meshes`: whether triangles close to a body.
`find_faces_with_area`: which triangles are ground.
`matrices`: applies transforms, with every sum written out."""
