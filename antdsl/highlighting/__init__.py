"""Highlights `.ant` text without a parser. One list of patterns, made from the tables of the language's words, becomes a TextMate
grammar for editors and a Pygments lexer."""
