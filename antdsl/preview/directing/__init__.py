"""Notes by hand: a page chooses a verb and fills its keys, the run follows, and the page shows the line to write.

`verb_forms` makes the table of verbs and their keys from the models of notes. `note_forms` makes a line of the values of a page,
and checks it as a line of a scene. `hand_notes` holds the notes of a session, and says how far back a change of them begins."""
