"""Notes on a scene, and edits of simulated frames, that the user makes on the page.

The page offers a list of verbs. The user chooses one and fills in its keys, and the page shows the line of YAML to write.

`verb_forms` makes the tables of verbs and keys from the models of notes and edits. `line_drafts` builds a line from the values
that the user entered. `note_forms` checks a note as a line of a scene. `hand_notes` holds the session's notes, which change the
run, and finds the first frame that a change of them affects. `recorded_frames` presents the simulated frames as a cache.
`hand_edits` checks edits and applies them to these frames, without changing the run. `hand_settling` simulates again the agents
that edits affect."""
