"""Which name means what: the first half of a check.

`collect` goes over all files once and gathers what they declare and which behaviours they can call. `ordering` puts declarations
after those that they use. `scope` returns what a name means at a place of the text. `missing` reports a thing of the world that
is not declared, with the line to write."""
