"""What people write that is not the language, and what to write instead.

`lookalikes` are characters from other keyboards, `numbers` slips of numbers and units, `stray_text` what was pasted with a
program (marks of a merge, fences of Markdown), `continued_lines` lines that go on without a bracket. `unexpected_tokens` makes
one complaint of what the parser found and what it could have taken."""
