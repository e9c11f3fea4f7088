"""Explains mistakes in programs, and suggests the text to write instead.

`number_slips` finds mistakes in numbers and units. `stray_text` finds characters from other keyboards and pasted text, such as
merge conflict markers or Markdown fences. `continued_lines` finds statements that continue on the next line although no bracket
is open. `unexpected_tokens` makes a message from the token that the parser found and the tokens that it expected."""
