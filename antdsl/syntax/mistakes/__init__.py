"""Explains mistakes in programs, and suggests the text to write instead.

`number_slips` is about numbers and units. `stray_text` is about characters from other keyboards and pasted text, such as merge
conflict markers or Markdown fences. `continued_lines` is about lines that continue without a bracket. `unexpected_tokens` makes
one message from the token that the parser found and the tokens that it expected."""
