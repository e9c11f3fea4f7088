"""The language server: it answers an editor's requests about `.ant` files and scenes, and runs the same checks as `antdsl
check`.

`server.start` starts it; this needs pygls (extra `[lsp]`). The other modules of this package work without pygls."""
