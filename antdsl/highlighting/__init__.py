"""Highlights `.ant` text without a parser. A list of patterns is made from the language's word tables. It becomes a TextMate
grammar for editors and a Pygments lexer."""
