"""Colours for `.ant` text where nobody parses: one list of patterns, made from the tables of the language's words, as a TextMate
grammar for editors and as a Pygments lexer."""
