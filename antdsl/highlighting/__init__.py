"""Colours for `.ant` text without a parser: one list of patterns, made from the tables of the language's words. It becomes a
TextMate grammar for editors and a Pygments lexer."""
