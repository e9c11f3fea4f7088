"""Every code with its meaning in one line. Codes are stable for ever; a room adds its own in its section, in order of the alphabet."""

from __future__ import annotations

CODES: dict[str, str] = {
    # --- reading a file ---
    "cannot-read": "the file is not there, is no regular file, or may not be read",
    "empty-file": "the file declares nothing: no species, no behaviour",
    "file-too-large": "the file is larger than a program may be",
    "not-an-ant-file": "the first bytes are those of another kind of file",
    "not-utf8": "the file holds bytes that are not UTF-8 text",
    # --- characters and words ---
    "bad-name": "a name has letters other than a to z in lower case, digits and `_`, or does not begin with a letter",
    "bad-number": "a number is not written with digits and at most one dot, or is too large or too small to be represented",
    "control-character": "the text holds a character that cannot be seen and has no meaning here",
    "hidden-direction": "the text holds a mark that turns the direction of writing, which can make it look like something else",
    "line-too-long": "a line has more characters than a line may have",
    "look-alike": "a letter or digit looks like one on the keyboard but is another",
    "markdown-fence": "the text holds the fence of a Markdown code block, pasted along with the code",
    "merge-conflict": "the text holds the marks of a merge that was not finished",
    "name-too-long": "a name has more characters than a name may have",
    "odd-blank": "a blank is not the one on the space bar",
    "unclosed-text": "text in quotes does not end on its line",
    "unknown-sign": "a sign has no meaning in the language",
    "unknown-unit": "the word after a number is not a unit",
    "wrong-quotes": "text stands in other quotes than \"",
    # --- lines and blocks ---
    "brace-on-own-line": "an opening brace stands on the line below the one that it belongs to",
    "expression-too-deep": "an expression has more operations inside each other than can be followed",
    "misplaced-line": "a line begins with a word that belongs in another kind of block",
    "missing-brace": "a block has no opening brace",
    "missing-edition": "the first line does not name the edition of the language",
    "missing-line-end": "two lines stand on one without `;` between them",
    "missing-result": "a behaviour has no line that says what it gives",
    "nesting-too-deep": "more brackets are open at once than may be",
    "second-result": "a behaviour has more than one line that says what it gives",
    "unclosed-brace": "a block is opened and never closed",
    "unclosed-bracket": "a parenthesis or bracket is opened and never closed",
    "unexpected-text": "something stands where the line cannot go on with it",
    "unfinished-line": "a line ends before it is complete",
    "unknown-edition": "the file is written in an edition of the language that this antdsl does not know",
    "unknown-line": "a line begins with a word that is not known there, but is close to one that is",
    "unopened-brace": "a closing brace has no opening one",
    "unopened-bracket": "a closing parenthesis or bracket has no opening one",
}
