"""Shapes of program, each of any size: what stands in them again and again is what a user's file, or a hostile one, has."""

from __future__ import annotations

from collections.abc import Callable

HEAD = "ant 1\nuse steering\nworld { surface ground; obstacle stones; items food { load = 0 } }\n"
START = "species walker {\n  start s\n  state s { steer wander() }\n"
END = "  layers { state }\n}\n"

Shape = Callable[[int], str]


def _filled(head: str, size: int, unit: Callable[[int], str], end: str = "") -> str:
    """`head`, as many units as fit, then `end`."""
    parts, length, k = [head], len(head.encode()) + len(end.encode()), 0
    while True:
        part = unit(k)
        length += len(part.encode())
        if length > size and k:
            break
        parts.append(part)
        k += 1
    return "".join(parts) + end


def _again(head: str, unit: str | Callable[[int], str], end: str = "") -> Shape:
    return lambda size: _filled(head, size, unit if callable(unit) else lambda k: unit, end)


def _file(unit: str | Callable[[int], str]) -> Shape:
    return _again(HEAD + START + END, unit)


def _species(unit: str | Callable[[int], str]) -> Shape:
    return _again(HEAD + START, unit, END)


def _state(unit: str | Callable[[int], str]) -> Shape:
    return _again(HEAD + "species walker {\n  start s\n  state s {\n    steer wander()\n", unit, "  }\n" + END)


def _expression(unit: str | Callable[[int], str], end: str = "") -> Shape:
    return _again(
        HEAD + "species walker {\n  start s\n  let a = 1\n  let x = (\n0", unit, end + "\n)\n  state s { steer wander() }\n" + END
    )


SHAPES: dict[str, Shape] = {
    "blank lines": _again("ant 1\n", "\n"),
    "blank lines and a species": _file("\n"),
    "blanks": _file(" " * 1500 + "\n"),
    "tabs": _file("\t\n"),
    "returns": _file("\r"),
    "comments": _file("# what an animal does\n"),
    "comments at the end of lines": _species("# a\n"),
    "comments that ignore": _file("# antdsl: ignore[unused-param] because\n"),
    "semicolons": _species(";"),
    "long lines of semicolons": _species(";" * 1500 + "\n"),
    "uses of the library": _file("use steering\n"),
    "uses of files": _file(lambda k: f'use "./m{k}.ant" as m{k}\n'),
    "uses of one file": _file(lambda k: f'use "./mine.ant" as m{k}\n'),
    "worlds": _file(lambda k: f"world {{ surface ground{k} }}\n"),
    "things of the world": _again("ant 1\nworld {\n", lambda k: f"  items food{k} {{ load = 0 }}\n", "}\n"),
    "fields": _file(lambda k: f"field f{k} on ground {{ cell 4 mm }}\n"),
    "species": _file(lambda k: f"species a{k} {{ start s; state s {{ }}; layers {{ state }} }}\n"),
    "species of one name": _file("species a { start s; state s { }; layers { state } }\n"),
    "behaviours": _file(lambda k: f"behaviour b{k}() -> push {{ heading * 0.5 }}\n"),
    "behaviours that call the one before": _file(
        lambda k: f"behaviour b{k}() -> push {{ {f'b{k - 1}()' if k else 'heading'} * 0.5 }}\n"
    ),
    "specs": _file(lambda k: f'spec "s{k}" {{ for 1 s; always: count(walker) > 0 }}\n'),
    "specs of one name": _file('spec "s" { for 1 s; always: count(walker) > 0 }\n'),
    "params": _species(lambda k: f"  param p{k} = 1 mm in 0 mm .. 2 mm\n"),
    "attributes": _species(lambda k: f"  a{k} = 0\n"),
    "lets": _species(lambda k: f"  let x{k} = {f'x{k - 1}' if k else '1'} + 1\n"),
    "lets of one name": _species("  let x = 1\n"),
    "handlers": _species("  on alarm { heading = up }\n"),
    "states": _species(lambda k: f"  state t{k} {{ when after 1 s -> t{k + 1} }}\n"),
    "states of one name": _species("  state t { when after 1 s -> s }\n"),
    "machines": _species(lambda k: f"  machine m{k} {{ start a; state a {{ }} }}\n"),
    "whens": _state("    when speed > 3 mm/s -> s\n"),
    "whens of states that are not there": _state(lambda k: f"    when speed > 3 mm/s -> t{k}\n"),
    "whens from any": _species("  from any when speed > 3 mm/s -> s\n"),
    "arguments named with an equals sign": _state("    steer seek(target = nearest(food))\n"),
    "steers": _state("    steer seek(nearest(food))\n"),
    "sums": _expression("\n+ a"),
    "sums on long lines": _expression("\n" + "+ a" * 600),
    "calls of many arguments": _expression("\n, 1", ""),
    "nested brackets": _species(lambda k: "  let x" + str(k) + " = " + "(" * 60 + "1" + ")" * 60 + "\n"),
    "brackets that are not closed": _species("  let x = (1 + (2\n"),
    "braces that are not closed": _file("species a { state b {\n"),
    "texts that are not closed": _species('  param p = 1 "what\n'),
    "texts": _file('"' + "a" * 80 + '"\n'),
    "names that are not known": _state(lambda k: f"    steer seek(nobody{k})\n"),
    "letters that cannot stand there": _species("  ~ $ ? !\n"),
    "units that are not known": _species(lambda k: f"  b{k} = 3 metr\n"),
    "layers": _again(
        HEAD + "species walker {\n  start s\n  state s { steer wander() }\n  layers {\n    state\n",
        "    avoid(stones)\n",
        "  }\n}\n",
    ),
}
