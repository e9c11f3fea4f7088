"""The built-in words of the language as data: words, units, colours, defaults.

These rows are used for types, costs, messages, the editor and the tables of the language reference. A word that is added here is
therefore available everywhere. `foreign_words` has words of other tools and their replacements. This package computes nothing."""
