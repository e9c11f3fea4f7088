"""The built-in knowledge of the language, as data: words, units, colours, defaults.

Types, costs, messages, the editor and the reference's tables read these rows; a word that is added here is known everywhere.
`other_words` has the words of other tools and what is written for them here. Nothing in this package computes."""
