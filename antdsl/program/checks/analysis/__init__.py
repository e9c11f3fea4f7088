"""What several checks find out about a program before they complain.

`checked` is what a check is given. `ranges` bounds values, `conditions` holds conditions against each other, and `short_steps`
finds what a value comes to as steps get shorter. None of them complains."""
