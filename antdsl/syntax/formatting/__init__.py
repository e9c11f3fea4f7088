"""Formats a text in the standard layout without changing the program.

`layout` is the interface. `items` converts tokens to statements with their blocks, and to comments. `bracket_reader` decides
where blanks are needed, `columns` aligns neighbouring lines, and `lines` breaks long lines. The output is parsed and compared
with the input before it is returned."""
