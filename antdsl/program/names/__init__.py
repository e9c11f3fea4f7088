"""Which name means what: the first half of a check.

`collect` goes over all files once and gathers what they declare and which behaviours they can call, `ordering` puts declarations
after those that they use, `scope` answers what a name means at a place of the text, and `missing` complains about a thing of the
world that nobody declared, with the line to write."""
