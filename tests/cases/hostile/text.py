"""Programs as text (A1 to A36): bytes, characters, sizes, numbers, units, names, files that are used, loops and settings."""

from __future__ import annotations

import os

from cases.hostile.rows import PROGRAM, SCENE, Row

_TEXT = PROGRAM.decode()
_STEER = "steer wander(swing: 40 deg)"


def program_row(name: str, text: str | bytes, verdict: str, words: str = "", *, warned: bool = False) -> Row:
    """A row with a program of this text."""
    return Row(name, verdict, words, {"walker.ant": text if isinstance(text, bytes) else text.encode()}, warned=warned)


def edit(name: str, old: str, new: str, verdict: str, words: str = "", *, warned: bool = False) -> Row:
    """A row with a program in which one piece of text is replaced."""
    assert old in _TEXT, name
    return program_row(name, _TEXT.replace(old, new, 1), verdict, words, warned=warned)


def line(name: str, text: str, verdict: str, words: str = "", *, warned: bool = False) -> Row:
    """A row with a species that has one more line."""
    return edit(name, "  start stroll", f"  {text}\n  start stroll", verdict, words, warned=warned)


def value(name: str, text: str, verdict: str, words: str = "") -> Row:
    """A row with a species that has an attribute of this value."""
    return line(name, f"calm = {text}", verdict, words)


def use(name: str, path: str, verdict: str, words: str = "") -> Row:
    """A row with a program that uses a file of this path."""
    return edit(name, "use steering", f'use steering\nuse "{path}" as mine', verdict, words)


def change(name: str, when: str, verdict: str, words: str = "") -> Row:
    """A row with one more change of state."""
    return edit(name, _STEER, f"{_STEER}; when {when} -> stroll", verdict, words)


def used(name: str, files: dict[str, str], verdict: str, words: str = "") -> Row:
    """A row with a program that uses `./a.ant`, with these files."""
    program = _TEXT.replace("use steering", 'use steering\nuse "./a.ant" as a', 1)
    return Row(name, verdict, words, {"walker.ant": program.encode()} | {k: v.encode() for k, v in files.items()}, warned=True)


_LIBRARY = 'ant 1\nbehaviour hold() -> push {\n  "Stays where it is."\n  vector(0, 0, 0)\n}\n'
_DOUBLING = "".join(f"  let a{n} = a{n - 1} + a{n - 1}\n" for n in range(1, 31))


def _behaviours(first: str, count: int) -> str:
    """Behaviours of which each asks twice for the one before."""
    bodies = [first, *(f"b{n - 1}() + b{n - 1}()" for n in range(1, count))]
    return "".join(f'behaviour b{n}() -> push {{\n  "Goes somewhere."\n  {body}\n}}\n' for n, body in enumerate(bodies))


ROWS = [
    program_row("A1 an empty file", "", "empty-file", "the file is empty"),
    program_row("A1 comments only", "# nothing\n# here\n", "empty-file"),
    program_row("A1 a byte order mark only", b"\xef\xbb\xbf", "empty-file"),
    program_row("A1 a byte order mark", b"\xef\xbb\xbf" + PROGRAM, ""),
    program_row("A2 invalid UTF-8", PROGRAM.replace(b"ant 1", b"ant 1 # \xe9"), "not-utf8", "byte 8"),
    program_row("A2 UTF-16", _TEXT.encode("utf-16"), "not-an-ant-file", "UTF-16"),
    program_row("A2 UTF-16 without a mark", _TEXT.encode("utf-16-le"), "control-character", "U+0000"),
    program_row("A2 UTF-8 with a surrogate", PROGRAM.replace(b"ant 1", b"ant 1 # \xed\xa0\x80"), "not-utf8"),
    *(
        edit(f"A3 U+{ord(sign):04X} in a comment", "ant 1\n", f"ant 1 # {sign}\n", "control-character", f"U+{ord(sign):04X}")
        for sign in "\0\a\x1b\x7f\x85\u2028\u2029"
    ),
    *(
        edit(f"A3 U+{ord(sign):04X} in a comment", "ant 1\n", f"ant 1 # {sign}\n", "hidden-direction", f"U+{ord(sign):04X}")
        for sign in "\u202a\u202e\u2066\u2069"
    ),
    edit("A4 a Cyrillic letter", "max_speed", "ma\u0445_speed", "look-alike", "max_speed"),
    edit("A4 a full-width digit", "4 mm", "\uff14 mm", "look-alike", "`4`"),
    edit("A4 an Arabic-Indic digit", "4 mm", "\u0664 mm", "look-alike", "`4`"),
    program_row("A5 CRLF", _TEXT.replace("\n", "\r\n"), ""),
    program_row("A5 CR", _TEXT.replace("\n", "\r"), ""),
    program_row("A5 mixed line ends", _TEXT.replace("\n", "\r\n", 3).replace("\n", "\r", 1), ""),
    program_row("A5 tabs and blanks", _TEXT.replace("  ", " \t"), ""),
    program_row("A5 no end of the last line", _TEXT.rstrip(), ""),
    program_row("A5 a line of 200,000 characters", _TEXT + "#" + "x" * 200_000 + "\n", "line-too-long", "at most 2000"),
    program_row("A6 280 kB", _TEXT + "# x\n" * 70_000, "file-too-large", "256 KiB"),
    Row("A6 a pipe", "not-a-file", "", make=lambda f: ((f / "walker.ant").unlink(), os.mkfifo(f / "walker.ant"))),
    Row("A6 a folder", "not-a-file", "", make=lambda f: ((f / "walker.ant").unlink(), (f / "walker.ant").mkdir())),
    value("A7 30,000 brackets", "(" * 30_000, "nesting-too-deep", "64"),
    value("A7 1,900 minus signs", "-" * 1_900 + "1", "expression-too-deep", "200"),
    program_row("A7 10,000 open states", _TEXT + "state a {" * 10_000, "nesting-too-deep", "64"),
    value("A8 900 terms", "+".join(["1"] * 900), "expression-too-deep", "200"),
    edit("A8 30 lets that double", _STEER, f"let a0 = speed / 1 mm/s\n{_DOUBLING}  steer wander(swing: a30 * 1 deg)", ""),
    program_row("A9 3,000 equal mistakes", _TEXT + "species b {\n" + "  steer nonsense\n" * 3_000 + "}\n", "misplaced-line"),
    edit("A10 text that does not end", "stroll amber", 'stroll "Walks amber', "unclosed-text"),
    program_row("A10 a block that does not end", _TEXT.rstrip()[:-1], "unclosed-brace"),
    program_row("A10 a bracket that does not end", _TEXT.rstrip()[:-5], "unclosed-bracket"),
    *(
        value(f"A11 {text}", text, "bad-number")
        for text in ("1e400", "1e-400", "0x10", "1_0", "1.2.3", ".5.", "00010", "7" * 500)
    ),
    *(value(f"A12 {text}", text, "bad-number", "not a number here") for text in ("nan", "inf", "-inf", "infinity")),
    edit("A13 an unknown unit", "4 mm", "5 metr", "unknown-unit", "write `m`"),
    edit("A13 no unit", "4 mm", "5", "missing-unit", "5 mm"),
    edit("A13 a time for a length", "4 mm", "5 s", "wrong-unit", "a time"),
    edit("A13 an angle without a unit", "40 deg", "30", "missing-unit"),
    edit("A13 a length for a speed", "30 mm/s", "5 mm", "wrong-unit", "a length"),
    edit("A13 a speed by the frame", "30 mm/s", "30 mm/frame", "unknown-unit", "per second"),
    value("A14 a product beyond float32", "1e30 m * 1e30 m / 1 m", "number-too-large"),
    *(value(f"A15 a division of {text}", text, "bad-name") for text in ("__class__", "_x", "__proto__")),
    *(
        line(f"A15 an attribute {name}", f"{name} = 1", "bad-name", "begins with `_`")
        for name in ("__class__", "_x", "__proto__")
    ),
    *(line(f"A15 an attribute {name}", f"{name} = 1", "reserved-name") for name in ("self", "import")),
    *(line(f"A15 an attribute {name}", f"{name} = 1", "unused-attribute") for name in ("np", "constructor", "eval", "prototype")),
    value("A16 a method of Python", "().__class__", "bad-name"),
    value("A16 a template", "${x}", "unknown-sign"),
    value("A16 another template", "{{x}}", "unexpected-text"),
    value("A16 SQL", "'; DROP", "unknown-sign"),
    value("A16 a command of a shell", "`ls`", "wrong-quotes"),
    edit("A17 signs of format strings", "stroll amber", 'stroll "%s %n {0.__class__} {}" amber', ""),
    edit("A18 an escape for the terminal", "stroll amber", 'stroll "\x1b[31m" amber', "control-character", "U+001B"),
    edit("A18 a command of GitHub", "stroll amber", 'stroll "::error::%0A" amber', ""),
    use("A19 a file that uses itself", "./walker.ant", "use-cycle", "walker.ant"),
    used("A19 a circle", {"a.ant": 'ant 1\nuse "./b.ant" as b\n', "b.ant": 'ant 1\nuse "./a.ant" as a\n'}, "use-cycle"),
    used("A19 a program of Python", {"a.ant": 'ant 1\nuse "./x.py" as b\n', "x.py": "import os\n"}, "bad-path", ".ant"),
    *(
        use(f"A20 {path!r}", path, "bad-path")
        for path in (
            "../x.ant", "/etc/passwd", "C:/x.ant", "//srv/share/x.ant", "~root/x.ant", "file:///x.ant", "http://x/x.ant",
            "./con.ant", "./aux.ant", "./x.ant:stream", "./x.ant.", "./x.ant ", "./../proj-evil/x.ant",
        )
    ),
    Row(
        "A21 a link to a file outside",
        "bad-path",
        "link",
        edits={"walker.ant": ("use steering", 'use steering\nuse "./a.ant" as a')},
        make=lambda f: (f / "a.ant").symlink_to("/etc/hostname"),
    ),
    Row(
        "A21 a link to a folder outside",
        "bad-path",
        "link",
        edits={"walker.ant": ("use steering", 'use steering\nuse "./sub/a.ant" as a')},
        make=lambda f: (f / "sub").symlink_to("/etc"),
    ),
    Row(
        "A22 a name of another case",
        "no-such-file",
        "differs by case only",
        {"lib.ant": _LIBRARY.encode()},
        {"walker.ant": ("use steering", 'use steering\nuse "./Lib.ant" as mine')},
    ),
    program_row(
        "A23 30 behaviours that double",
        _TEXT.replace("species walker", _behaviours("vector(0, 0, 0)", 31) + "species walker").replace(_STEER, "steer b30()"),
        "too-large",
        "20,000",
    ),
    program_row(
        "A24 behaviours in a circle",
        _TEXT.replace("species walker", _behaviours("b2()", 3) + "species walker").replace(_STEER, "steer b2()"),
        "circle",
        "b2",
    ),
    line("A24 lets in a circle", "let a = b; let b = a", "circle"),
    change("A25 a change that always fires", "speed >= 0 mm/s", "always-fires"),
    change("A26 a change that never fires", "speed < 0 mm/s", "never-fires"),
    line("A26 an unused let", "let near = 1", "unused-let"),
    edit("A26 two states of one name", "\n}\n", "\n  state stroll { steer halt() }\n}\n", "duplicate-name"),
    edit("A26 a state that nothing leads to", "\n}\n", "\n  state rest { steer halt() }\n}\n", "unreachable-state"),
    edit(
        "A27 two machines write one attribute",
        "  start stroll",
        "  mood = 0\n"
        + "".join(
            f"  machine m{n} {{\n    start a{n}\n    state a{n} {{ mood = {n}; when mood > 5 -> a{n} }}\n  }}\n" for n in (1, 2)
        )
        + "  start stroll",
        "two-writers",
    ),
    edit("A28 a field that is not there", _STEER, f"{_STEER}; deposit trail 1 /s", "unknown-field"),
    edit(
        "A28 a field that nothing lays",
        "species walker {",
        "field trail on ground { half_life 1 s; cell 4 mm }\nspecies walker {\n  smell = max(trail)",
        "unlaid-field",
    ),
    edit("A28 digging in a surface", _STEER, f"{_STEER}; carve ground(radius: 3 mm)", "unknown-name", "no solid"),
    value("A29 division by 0", "1 / 0", "division-by-zero"),
    value("A29 the root of -1", "sqrt(-1)", "root-of-negative"),
    value("A29 a range from right to left", "clamp(size / 1 mm, 5 .. 1)", "empty-range"),
    value("A29 a draw from right to left", "uniform(5, 1)", "empty-range"),
    change("A30 a chance without a time", "chance 150 %", "not-a-rate", "%/s"),
    change("A30 a chance below 0", "chance -1 /s", "out-of-range"),
    change("A30 a chance by the frame", "chance 5 %/frame", "unknown-unit"),
    change("A31 a time shorter than any frame", "after 0.0001 s", "out-of-range", "write `1 step`"),
    change("A31 a time below 0", "after -1 s", "out-of-range"),
    change("A31 a time longer than any run", "after 1e12 s", "never-fires"),
    edit(
        "A32 neighbours within 1e9 m",
        _STEER,
        "steer separate(radius: 1e9 m)",
        "wide-radius",
    ),
    program_row(
        "A33 257 states",
        _TEXT.replace("\n}\n", "\n" + "".join(f"  state s{n} {{ steer halt() }}\n" for n in range(257)) + "}\n"),
        "too-many",
        "256",
    ),
    program_row(
        "A33 300 attributes",
        _TEXT.replace("  start stroll", "".join(f"  a{n} = {n}\n" for n in range(300)) + "  start stroll"),
        "too-many",
        "256",
    ),
    program_row("A34 a merge conflict", "<<<<<<< HEAD\n" + _TEXT, "merge-conflict"),
    edit("A34 typographic quotes", "stroll amber", "stroll \u201cWalks\u201d amber", "wrong-quotes"),
    edit("A34 a no-break space", "size 4 mm", "size 4\u00a0mm", "odd-blank"),
    program_row("A34 a fence of Markdown", f"```ant\n{_TEXT}```\n", "markdown-fence"),
    edit("A35 a newer edition", "ant 1\n", "ant 9\n", "unknown-edition", "newer antdsl"),
    edit("A35 no edition", "ant 1\n", "", "missing-edition"),
    program_row("A36 YAML", SCENE, "not-an-ant-file", "YAML"),
    program_row("A36 JSON", '{"a": 1}', "not-an-ant-file", "JSON"),
    program_row("A36 a USD crate", b"PXR-USDC" + bytes(60), "not-an-ant-file", "USD"),
    program_row("A36 a picture", b"\x89PNG\r\n\x1a\n" + bytes(60), "not-an-ant-file", "picture"),
]  # fmt: skip
