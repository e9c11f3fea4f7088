"""The built-in words of the language as data: words, units, colours, defaults.

Types, costs, messages, the editor and the tables of the reference use these rows. A word that is added here therefore works
everywhere. `foreign_words` has words of other tools and their replacements. This package computes nothing."""
