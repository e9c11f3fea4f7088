"""Formats a text in the one layout without changing the program.

`layout` is the interface. Tokens become `items` (statements with their blocks, and comments). `bracket_reader` decides the blanks
between words, `columns` aligns marks of neighbouring lines, `lines` breaks long lines. The output is parsed and compared with the
input before it is returned."""
