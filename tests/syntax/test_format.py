"""`syntax.format`: one layout, the same program, the same comments, whatever the text looked like before."""

from __future__ import annotations

import random
import re

import pytest
from layouts import Layout, program
from test_docs import Block, of_kind

from antdsl.source import Source
from antdsl.syntax import format, parse
from antdsl.syntax import nodes as n
from antdsl.syntax.formatting.layout import LayoutError, find_first_difference, iterate_tree_texts
from antdsl.syntax.formatting.lines import MAX_LINE_CHARACTERS


def formatted(text: str) -> str:
    new_text, report = format(Source("t.ant", text))
    assert new_text is not None, [(d.code, d.message, str(d.span)) for d in report.diagnostics]
    return new_text


def meaning(text: str) -> list[str]:
    file, report = parse(Source("t.ant", text))
    assert report.ok, [(d.code, d.message, str(d.span)) for d in report.diagnostics]
    return list(iterate_tree_texts((file.edition, file.help, file.items)))


def holds(seed: int) -> bool:
    """One text laid out at random: idempotent, the same program, the same comments. False where the text could not be read."""
    rng = random.Random(seed)
    text = program(rng)
    layout = Layout(rng)
    other = layout.again(text)
    if not parse(Source("t.ant", other))[1].ok:
        return False
    formatted_text = formatted(other)
    assert formatted(formatted_text) == formatted_text, seed
    assert meaning(formatted_text) == meaning(text), seed
    assert [each.rstrip() for each in re.findall(r"# c\d+.*", formatted_text)] == layout.comments, seed
    assert (
        "\n\n\n" not in formatted_text
        and not re.search(r"[ \t\r]$", formatted_text, re.M)
        and "\t" not in re.sub(r'"[^"\n]*"|#.*', "", formatted_text)
    ), seed
    plain = formatted(text)
    assert formatted(Layout(rng, free=False).again(re.sub(r"#.*", "", text))) == formatted(re.sub(r"#.*", "", plain)), seed
    return True


CASES: dict[str, tuple[str, str]] = {
    "blanks, units, signs": (
        "state s{deposit trail(x+1)*2;x-=-  1;x=likes [ a ] . y^-2;when x->choose{a:1;b :2}{x=30mm/s}\n}",
        """state s {
  deposit trail (x + 1) * 2
  x -= -1
  x = likes[a].y ^ -2
  when x -> choose { a: 1; b: 2 } { x = 30 mm/s }
}
""",
    ),
    "a block stays on its line": ("state s{steer  halt( ) }", "state s { steer halt() }\n"),
    "and open where a line began in it": ("state s{ steer halt()\n}", "state s {\n  steer halt()\n}\n"),
    "nothing in it": ("layers {\n\n}", "layers {}\n"),
    "one statement a line, one blank line at most": (
        "\n\nx = 1; y = 2\n\n\n\nz = 3 ;; on spawn{ x=2\n\n }\n",
        "x = 1\ny = 2\n\nz = 3\non spawn {\n  x = 2\n}\n",
    ),
    "columns": (
        """param a = 1 in 0 .. 1 "one"
param long_name: number = 100 "two" # why
size 4 mm # body
max_speed 3 mm/s

on spawn { x = 1 } # not far
when_ = 1 "text"
# between
longest = 22 "text"
""",
        """param a                 = 1 in 0 .. 1 "one"
param long_name: number = 100         "two"  # why
size      4 mm                               # body
max_speed 3 mm/s

on spawn { x = 1 }  # not far
when_ = 1 "text"
# between
longest = 22 "text"
""",
    ),
    "a mark far out moves nobody": (
        f"let a = 1\nlet abc = 1\nstate s {{\nwhen x -> a\nwhen {'x + ' * 20}x -> b\nwhen x + y -> c\n}}",
        f"let a   = 1\nlet abc = 1\nstate s {{\n  when x     -> a\n  when {'x + ' * 20}x -> b\n  when x + y -> c\n}}\n",
    ),
    "long lines": (
        "let scent = max(" + "first_name + second_name * third_name, " * 4 + "1)\n"
        "let other = (" + "first_condition and second_condition or " * 4 + 'x) "help"\n'
        "let third = sum(n in neighbours(radius): " + "third_name_of_all * " * 6 + "n.speed)\n",
        "let scent = max(\n" + "  first_name + second_name * third_name,\n" * 4 + "  1\n)\n"
        "let other = (\n  first_condition and second_condition\n"
        + "  or first_condition and second_condition\n"
        * 3
        + '  or x\n) "help"\n'
        "let third = sum(\n  n in neighbours(radius):\n    third_name_of_all\n"
        + "    * third_name_of_all\n" * 5
        + "    * n.speed\n)\n",
    ),
    "comments inside brackets": (
        """let a = max( # first
x, # the one
# alone
y # the other
# last
)
let b = (x # why x
  or y) # why y
let c = min(x, f(1 # deep
  ) + # middle
  2)
""",
        """let a = max(
  # first
  x,  # the one
  # alone
  y  # the other
  # last
)
let b = (
  x  # why x
  or y
)  # why y
let c = min(
  x,
  f(
    1  # deep
  )
    # middle
    + 2
)
""",
    ),
    "comments around blocks": (
        "state s { # head\n# own\nx = 1 /s # one\n\n\n# foot\n} # behind",
        "state s {  # head\n  # own\n  x = 1 /s  # one\n\n  # foot\n}  # behind\n",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_layout(name: str) -> None:
    messy_lines, expected_lines = CASES[name]
    start, end = "ant 1\nspecies a {\n", "}\n"
    expected = start + "".join(f"  {line}\n" if line else "\n" for line in expected_lines.splitlines()) + end
    assert formatted(f"{start}{messy_lines}\n{end}") == expected
    assert formatted(expected) == expected


def test_names_of_arguments_may_be_words_that_begin_lines() -> None:
    arguments = [
        "on: obstacle",
        "spread_that_is_long: angle = 35 deg",
        "reach_that_is_long: length = 1.5 * size",
        "state: number = 1",
    ]
    text = formatted(f"ant 1\nbehaviour avoid({', '.join(arguments)}) -> push {{ up }}\n")
    assert text == "ant 1\nbehaviour avoid(\n  " + ",\n  ".join(arguments) + "\n) -> push {\n  up\n}\n"


def test_texts_with_errors_are_unchanged() -> None:
    text, report = format(Source("t.ant", "ant 1\nspecies a { size 4 mm\n"))
    assert text is None and [d.code for d in report.errors] == ["unclosed-brace"]


def test_a_text_that_only_has_warnings_is_formatted() -> None:
    text, report = format(Source("t.ant", "\ufeffspecies a{size 4mm}\r\n"))
    assert text == "species a { size 4 mm }\n" and [d.code for d in report.diagnostics] == ["missing-edition"]


def test_layouts_with_another_meaning_are_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    for wrong in (
        "ant 1\nspecies a { size 5 mm }\n# c\n",
        "ant 1\nspecies a { size 4 mm }\n",
        "ant 1\nspecies a { size 4 mm \n# c\n",
    ):
        monkeypatch.setattr("antdsl.syntax.formatting.layout.format_items", lambda items, wrong=wrong: wrong)
        with pytest.raises(LayoutError):
            format(Source("t.ant", "ant 1\nspecies a { size 4 mm } # c\n"))


def test_unreadable_layouts_are_not_written(monkeypatch: pytest.MonkeyPatch) -> None:
    text = 'ant 1\nspecies a {\n  let b = min(x,\n    y) "' + "x" * 1985 + '"\n}\n'
    assert parse(Source("t.ant", text))[1].ok
    new_text, report = format(Source("t.ant", text))
    assert new_text is None and [d.code for d in report.errors] == ["line-too-long"]
    monkeypatch.setattr("antdsl.limits.MAX_PROGRAM_BYTES", 200)
    new_text, report = format(Source("t.ant", "ant 1\nspecies a {" + "x=1;" * 45 + "y=1}"))
    assert new_text is None and [d.code for d in report.errors] == ["file-too-large"]


def test_a_difference_is_named() -> None:
    def file(text: str) -> n.File:
        return parse(Source("t.ant", text))[0]

    one = file("ant 1\nspecies a { size 4 mm; x = 1 + 2 * 3 }")
    assert find_first_difference(one, file("ant 1 # c\nspecies a { size 4 mm; x = 1 + 2 * 3 }")) == "a comment was lost"
    assert find_first_difference(one, file("ant 1\nspecies a { size 4 mm; x = (1 + 2) * 3 }")) is not None
    assert find_first_difference(one, file("ant 1\nspecies a { size 4 mm; x = 1 + 2 * 4 }")) == "`3.0` became `4.0`"
    assert (
        find_first_difference(one, file("ant 1\nspecies a { size 4 mm; x = 1 + (2 * 3); y = 1 }"))
        == "`2 things` became `3 things`"
    )
    assert find_first_difference(one, file("ant 1\n\nspecies a {size 4mm\nx = 1 + (2 * 3) }")) is None


def test_a_line_that_is_too_long_has_nothing_to_break() -> None:
    long = 0
    for seed in range(60):
        for line in formatted(re.sub("#.*", "", program(random.Random(seed)))).splitlines():
            code = re.sub(' *"[^"]*"$', "", line)
            indent = len(code) - len(code.lstrip())
            code = " " * indent + re.sub(" +", " ", code.lstrip())  # what stands in columns may be wider
            if len(code) > MAX_LINE_CHARACTERS:
                long += 1
                assert not re.search(r"\([^()]+\)|\[[^][]+\]|{ ", code), code
    assert long < 20


def test_any_layout_becomes_the_standard_one() -> None:
    read = [holds(seed) for seed in range(40)]
    assert sum(read) > 0.95 * len(read)


@pytest.mark.slow
def test_any_of_ten_thousand_layouts_becomes_the_standard_one() -> None:
    read = [holds(seed) for seed in range(1000, 11_500)]
    assert sum(read) >= 10_000


# --- the samples of the documents ------------------------------------------------------------------------------------

# What stands around a fragment, and how far its lines are set in there.
AROUND = {
    None: ("", "", 0),
    "file": ("ant 1\n", "", 0),
    "species": ("ant 1\nspecies a {\n", "}\n", 2),
    "state": ("ant 1\nspecies a {\n  state s {\n", "  }\n}\n", 4),
}


def sample(block: Block) -> str | None:
    """A document's sample in the one layout; None for one that is no program, or shows an error of writing."""
    part = next((word.removeprefix("fragment-of-") for word in block.words if word.startswith("fragment-of-")), None)
    if part not in AROUND:
        return None
    start, end, indent = AROUND[part]
    text, _ = format(Source(str(block), start + block.text + end))
    if text is None:
        return None
    assert text.startswith(start) and text.endswith(end)
    return "".join(line[indent:] if line.strip() else line for line in text[len(start) : len(text) - len(end)].splitlines(True))


@pytest.mark.parametrize("block", of_kind("ant"), ids=str)
def test_samples_have_the_standard_layout(block: Block) -> None:
    expected = sample(block)
    assert expected is None or expected == block.text


def test_most_samples_are_formatted() -> None:
    assert sum(sample(block) is not None for block in of_kind("ant")) > 25
