"""Highlighting of `.ant` text without a parser.

A list of patterns is made from the language's word tables. It is converted to a TextMate grammar for editors and to a Pygments
lexer."""
