"""Notes and edits by hand: a page chooses a verb and fills its keys, and shows the line to write.

`verb_forms` makes the tables of verbs and their keys from the models of notes and edits. `line_drafts` makes a line of the values
of a page. `note_forms` checks it as a line of a scene. `hand_notes` holds the notes of a session, which the run follows, and says
how far back a change of them begins. `recorded_frames` offers the simulated frames as a cache. `hand_edits` checks edits of them
and applies them, without a change of the run. `hand_settling` simulates the agents again that edits affect."""
