"""Bodies in glTF files: read as agent definitions, and written."""
