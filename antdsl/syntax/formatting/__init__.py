"""A text to the same program in the one layout.

`layout` is the door: tokens become `items` (statements with their blocks, and comments), `brackets` decides the blanks between
words, `columns` puts marks of neighbouring lines below each other, `lines` breaks what is too long. What comes out is parsed and
held against what went in before anybody gets it."""
