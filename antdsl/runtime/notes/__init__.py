"""Notes of a scene: they change what agents do in some frames.

`NoteRun` holds the notes of a world and what they remember. In each step it finds the notes that are active and their agents,
then calls the functions of the table `VERBS` at the stages of a step. A scene without notes has no `NoteRun`.
Notes act on the results of decisions and layers, before agents move. So limits, contacts, obstacles and clearances hold, and
other agents react. A note is a function of the frame, the world and its memory, which checkpoints contain."""
