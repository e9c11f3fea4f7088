"""Edits of a finished cache: from lines of text to a view of the cache in which they are applied. The cache stays unchanged.

`edit_lines` reads the lines, one pydantic model for each verb in `verb_table`. Each edit becomes an `EditLayer`, a cache
that reads the cache below it and changes its frames. `edited_cache` stacks the layers in the order of the text, with those that
read the result of all others last. `stored_edits` writes the text into the manifest, takes it away, or writes the frames of the
view as a new cache."""
