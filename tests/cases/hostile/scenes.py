"""Scenes as text (Y1 to Y18 but Y10, which is in `volumes.py`): YAML's own traps, values, keys, numbers, paths and limits."""

from __future__ import annotations

from cases.hostile.rows import SCENE, Row

_TEXT = SCENE.decode()


def scene_row(name: str, scene: str | bytes, verdict: str, words: str = "") -> Row:
    """A row with a scene of this text."""
    return Row(name, verdict, words, {"scene.yaml": scene if isinstance(scene, bytes) else scene.encode()})


def edit(name: str, old: str, new: str, verdict: str, words: str = "") -> Row:
    """A row with a scene in which one piece of text is replaced."""
    assert old in _TEXT, name
    return scene_row(name, _TEXT.replace(old, new, 1), verdict, words)


def appended_row(name: str, lines: str, verdict: str, words: str = "") -> Row:
    """A row with a scene that has more lines at its end."""
    return scene_row(name, f"{_TEXT}{lines}\n", verdict, words)


def ground(name: str, settings: str, verdict: str, words: str = "") -> Row:
    """A row with a ground that has more settings."""
    return edit(name, "ground.ply}", f"ground.ply, {settings}}}", verdict, words)


_LEVELS = "x:\n" + "".join(" " * depth + "-\n" for depth in range(1, 40))
_SPECIES = "  - {species: walker, from: walker.ant, count: 1, place: {on: ground}}\n" * 10_000

ROWS = [
    scene_row("Y1 aliases that double", "a: &a [x, x]\nb: &b [*a, *a]\n" + _TEXT, "yaml-alias"),
    scene_row("Y1 an alias of itself", "a: &a [*a]\n" + _TEXT, "yaml-alias"),
    scene_row("Y1 merges that double", "a: &a {x: 1}\nb: {<<: *a}\n" + _TEXT, "yaml-alias"),
    *(
        edit(f"Y2 {tag}", "seed: 1", f"seed: {tag} [x]", "yaml-tag")
        for tag in ("!!python/object/apply:os.system", "!!python/name:os.system", "!!binary", "!!set", "!custom")
    ),
    scene_row("Y2 a directive for tags", "%TAG ! tag:x,2000:\n---\n" + _TEXT, "yaml-tag"),
    scene_row("Y2 YAML 3.0", "%YAML 3.0\n---\n" + _TEXT, "scene-syntax", "directives"),
    edit("Y3 5,000 brackets", "seed: 1", "seed: " + "[" * 5_000, "too-large", "32 levels deep"),
    edit("Y3 1,000 braces", "seed: 1", "seed: " + "{a: " * 1_000, "too-large", "32 levels deep"),
    scene_row("Y3 40 levels of lists", _TEXT + _LEVELS, "too-large", "32 levels deep"),
    appended_row("Y4 a key twice", "seed: 2", "duplicate-key", "`seed`"),
    appended_row("Y4 a key in upper case", "Seed: 2", "duplicate-key", "by case only"),
    appended_row("Y4 a list as a key", "? [a, b]\n: 1", "wrong-value", "one word"),
    appended_row("Y4 an empty key", "'': 1", "wrong-value", "one word"),
    appended_row("Y4 a null key", "~: 1", "unknown-key", "`~`"),
    appended_row("Y4 a merge key", "<<: {seed: 3}", "yaml-alias", "merges"),
    *(
        edit(f"Y5 fps {value}", "fps: 24", f"fps: {value}", "wrong-value", value)
        for value in ("1:30", "no", "1_000", "0x10", ".inf", ".nan", "~", "2001-13-45", "2001-01-01", "1e3", "on")
    ),
    edit("Y5 a seed with a leading 0", "seed: 1", "seed: 010", ""),
    *(
        edit(f"Y6 seed {value[:24]}", "seed: 1", f"seed: {value}", "wrong-value")
        for value in ("-1", "18446744073709551616", "1.5", "abc", "7" * 5_000)
    ),
    edit("Y6 the largest seed", "seed: 1", "seed: 18446744073709551615", ""),
    edit("Y6 no seed", "seed: 1\n", "", ""),
    scene_row("Y7 two documents", f"{_TEXT}---\n{_TEXT}", "scene-syntax", "second document"),
    scene_row("Y7 nothing", "", "empty-scene"),
    scene_row("Y7 comments only", "# nothing\n", "empty-scene"),
    scene_row("Y7 a list", "- 1\n", "wrong-value", "antdsl: 1"),
    scene_row("Y7 a word", "hello\n", "wrong-value", "antdsl: 1"),
    appended_row("Y8 an unknown key", "wibble: 2", "unknown-key", "known here"),
    edit("Y8 a misspelt key", "seed:", "sede:", "unknown-key", "did you mean `seed`?"),
    edit("Y8 a key of another level", "count: 20", "count: 20, fps: 3", "unknown-key", "known here"),
    edit("Y9 no agents", "count: 20", "count: 0", ""),
    *(edit(f"Y9 count {value}", "count: 20", f"count: {value}", "wrong-value") for value in ("-5", "1e12", "1.5", "5000001")),
    *(edit(f"Y9 frames {value}", "1..6", value, "wrong-value") for value in ("5..1", "1e9", "1..9000000")),
    *(edit(f"Y9 fps {value}", "fps: 24", f"fps: {value}", "wrong-value") for value in ("0", "-24", "1e9", "961")),
    edit("Y9 fps 23.976", "fps: 24", "fps: 23.976", ""),
    edit("Y9 fps 24000/1001", "fps: 24", "fps: 24000/1001", ""),
    *(
        edit(f"Y11 {path!r}", "ground.ply", f'"{path}"', "bad-path")
        for path in (
            "../x.ply", "/etc/passwd", "C:/x.ply", "//srv/x.ply", "~/x.ply", "file:///x.ply", "http://x/x.ply", "con.ply",
            "x.ply\\0", "ground.ply/", "x.ply.", "sub/../../x.ply",
        )
    ),
    *(
        edit(f"Y12 {path}", "ground.ply", f'"{path}"', "bad-path", "not expanded")
        for path in ("$HOME/x.ply", "*.ply", "%APPDATA%/x.ply")
    ),
    scene_row("Y13 10,000 lines of a crowd", _TEXT + _SPECIES, "too-large", "50,000 values"),
    edit("Y13 a word of 900 kB", "seed: 1", "seed: " + "x" * 900_000, "wrong-value"),
    edit("Y13 200,000 escapes", "seed: 1", 'seed: "' + "\\x41" * 200_000 + '"', "wrong-value"),
    appended_row("Y13 a comment of 1 MB", "#" + "x" * 1_000_000, ""),
    appended_row("Y13 2 MB", "#" + "x" * 2_000_000, "too-large", "1,048,576"),
    edit("Y14 a tab", "  ground:", "\tground:", "scene-syntax", "indent with blanks"),
    scene_row("Y14 a byte order mark", b"\xef\xbb\xbf" + SCENE, ""),
    scene_row("Y14 UTF-16", _TEXT.encode("utf-16"), "not-utf8", "UTF-16"),
    scene_row("Y14 invalid UTF-8", SCENE + b"# \xe9\n", "not-utf8", "byte 172"),
    scene_row("Y14 a zero", SCENE + b"# \0\n", "control-character", "U+0000"),
    appended_row("Y15 a param that is not there", "set: {walker.wibble: 1}", "unknown-thing", "wibble"),
    appended_row("Y15 a param of code", 'set: {walker.wibble: "2*os"}', "wrong-value", "unknown unit"),
    *(appended_row(f"Y16 {key}", f"{key}: 1", "unknown-key")
      for key in ("plugin", "import", "limits", "threads", "checks", "python")),
    ground("Y17 a negative zero", "at: [-0.0, 0, 0]", ""),
    ground("Y17 a subnormal number", "at: [5e-324, 0, 0]", ""),
    ground("Y17 19 digits", "at: [0.1234567890123456789, 0, 0]", ""),
    ground("Y17 1e308", "at: [1e308, 0, 0]", "wrong-value", "too large"),
    *(ground(f"Y17 {value}", f"at: [{value}, 0, 0]", "wrong-value", "representable") for value in ("1e400", "1e-400")),
    ground("Y18 a scale of 1e12", "scale: 1e12", "wrong-value"),
    ground("Y18 a scale of 0", "scale: 0", "wrong-value"),
    ground("Y18 a mirror", "scale: -1", "mirrored"),
    ground("Y18 two angles", "rotate: [1, 2]", "wrong-value"),
    ground("Y18 a quaternion of zeros", "rotate: [0, 0, 0, 0]", "wrong-value"),
]  # fmt: skip
