"""Agent definitions in files: read from JSON documents, glTF or USD, checked, and written.

- `reading` takes a file and returns a `Definition`.
- `json_text` parses JSON into a tree with locations.
- `document_errors` reads the tree into the models of `document_model` and reports mistakes.
- `definition_document` builds the definition, and `documents`, `clip_document` and `shape_references` its parts.
- `named_files` opens the files that a definition names.
- `definition_checks` checks the complete definition.
- `gltf` and `usd_body` convert a glTF or a USD file to a definition. `usd_body` runs only in the reader's process.
- `writing` writes a definition.
"""
