"""Notes of a scene, which change what agents do in some frames.

`NoteRun` contains the notes of a world and their memory. In each step it finds the notes that are active and their agents,
then calls the functions of the table `VERBS` at the stages of a step. A scene without notes has no `NoteRun`. Notes act on the
results of decisions and layers, before agents move. So limits, contacts, obstacles and clearances hold, and other agents
react. The effect of a note depends only on the frame, the world, and the note's memory, which checkpoints contain."""
