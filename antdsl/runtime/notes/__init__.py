"""Notes of a scene: instructions that change what agents do in some frames.

`ActiveNotesRun` contains the notes of a world and their memory. In each step it finds the active notes and their agents. Then it
calls the functions of the table `FUNCTIONS_BY_NOTE_VERB` at the stages of the step. Without notes, a scene has no
`ActiveNotesRun`. Notes change the results of decisions and layers before agents move. So limits, contacts, obstacles and
clearances still hold, and other agents react. The effect of a note depends only on the frame, the world, and the note's memory,
which checkpoints contain."""
