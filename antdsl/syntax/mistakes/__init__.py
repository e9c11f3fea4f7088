"""What people write that is not the language, and what to write instead.

`number_slips` are slips of numbers and units, `stray_text` characters from other keyboards and what was pasted with a program
(marks of a merge, fences of Markdown), `continued_lines` lines that go on without a bracket. `unexpected_tokens` makes
one complaint of what the parser found and what it could have taken."""
