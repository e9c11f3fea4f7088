"""Agent definitions in files: read from JSON documents, glTF or USD, checked, and written.

`reading` takes a file and gives a `Definition`; `definition_document` reads the JSON file that names all parts, `documents`,
`clip_document`, `definition_parts` and `shape_references` the forms of these. `json_text` and `checked_values` give values their
places in the text, `named_files` opens what a file names, `definition_checks` looks at the complete definition. `gltf_body` and
`usd_body` make a definition of a glTF or a USD file; the latter runs in the reader's process alone. `definition_written` and
`gltf_written` write one."""
