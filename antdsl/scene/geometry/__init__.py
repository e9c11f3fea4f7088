"""Geometry files to arrays: meshes, points and painted values, read with suspicion.

Counts in a file are held against its size before anything is allocated, and a reader of a library never sees a file that was not
judged first. `meshes` chooses a reader by the file's ending: `obj_file`, `ply` and `ply_body`, `stl_file`, `gltf_mesh`, `usd`.
`mesh_text` is the tokenizer of text files, `polygons` the triangulator of all, `import_notes` what a reader left out or changed.
`points` and `arrays` read places and .npz files, `painted` reads values on vertices. `closed` tells whether triangles close to a
body, `live_faces` says which triangles are ground, `matrices` applies transforms with
every sum written out."""
