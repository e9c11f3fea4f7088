"""Edits of a finished cache. They are lines of text, and are applied in a view of the cache. The cache itself does not change.

`edit_lines` reads the lines, with one pydantic model for each verb in `verb_table`. Each edit becomes an `EditLayer`: a cache
that reads the cache below it, and changes its frames. `edited_cache` stacks the layers in the order of the text. Layers that read
the result of all others come last. `stored_edits` writes the text to the manifest, removes it, or writes the frames of the view
as a new cache."""
