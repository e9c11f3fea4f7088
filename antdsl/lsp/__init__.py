"""The language server: answers an editor's requests about `.ant` files and scenes, with the checks that `antdsl check` runs.

`server.start` runs it; it needs pygls, the extra `[lsp]`. All other files of this package work without it."""
