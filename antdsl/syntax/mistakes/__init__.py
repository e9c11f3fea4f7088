"""Mistakes in programs, with the text to write instead.

`number_slips` has mistakes in numbers and units. `stray_text` has characters from other keyboards and pasted text, such as marks
of a merge or fences of Markdown. `continued_lines` has lines that continue without a bracket. `unexpected_tokens` makes one
message from what the parser found and what it could have accepted."""
