"""Agent definitions in files: read from JSON documents, glTF or USD, checked, and written.

`reading` takes a file and gives a `Definition`. `json_text` parses JSON to a tree with places, `document_errors` reads the tree
into the models of `document_model` and reports mistakes. `definition_document` builds the definition, `documents`,
`clip_document` and `shape_references` its parts, `named_files` opens what a file names, `definition_checks` looks at the complete
definition. `gltf_body` and `usd_body` make a definition of a glTF or a USD file; the latter runs in the reader's process alone.
`writing` writes one."""
