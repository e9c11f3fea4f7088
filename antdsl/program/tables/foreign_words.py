"""Words that other tools use for functions and names, with their replacements in this language."""

from __future__ import annotations

import re

from antdsl.syntax import nodes

# `{a}`: the source text of the first argument. `{A}`: the same, in brackets if it has several terms.
_FOREIGN_CALLS = (
    ("lerp interpolate interp blend tween", "mix({a}, {b}, {c})"),
    ("saturate clamp01 sat", "clamp({a}, 0 .. 1)"),
    ("constrain bound bounded", "clamp({a}, {b} .. {c})"),
    ("remap fit map_range maprange map scale_range linmap", "ramp({a}, from: {b} .. {c}, to: {d} .. {e})"),
    ("fit01", "ramp({a}, from: 0 .. 1, to: {b} .. {c})"),
    ("smoothstep linstep linearstep inverse_lerp inverselerp unlerp", "rising({c}, {a} .. {b})"),
    ("step", "(if {B} > {A} then 1 else 0)"),
    ("pow power", "{A} ^ {B}"),
    ("sqr square squared", "{A} ^ 2"),
    ("cbrt", "{A} ^ (1 / 3)"),
    ("fract frac", "({A} - floor({a}))"),
    ("mod fmod modulo", "({A} - {B} * floor({A} / {B}))"),
    ("ceil ceiling", "-floor(-{A})"),
    ("round rint", "floor({A} + 0.5)"),
    ("trunc int", "floor({a})"),
    ("sign sgn", "(if {A} < 0 then -1 else 1)"),
    ("norm magnitude mag len vlength", "length({a})"),
    ("normalize normalise normalized normalised", "unit({a})"),
    ("vec vec3 vector3 float3 xyz", "vector({a}, {b}, {c})"),
    ("fabs absolute", "abs({a})"),
    ("minimum fmin", "min({a}, {b})"),
    ("maximum fmax", "max({a}, {b})"),
    ("ln", "log({a})"),
    ("log10", "log({a}) / log(10)"),
    ("log2", "log({a}) / log(2)"),
    ("tan", "sin({a}) / cos({a})"),
    ("acos asin atan atan2", "angle({a}, {b})"),
    ("cond iif ternary select", "(if {a} then {b} else {c})"),
    ("choose choice choices sample oneof one_of", "pick({a}, {b})"),
    ("gauss gaussian randn random_normal normalvariate", "normal({a}, {b})"),
    ("randint irandom random_int", "floor(uniform({a}, {B} + 1))"),
    ("avg average", "mean(n in neighbours(20 mm): n.speed)"),
    ("radians deg", "{A} * 1 deg"),
    ("degrees rad", "{A} * 1 rad"),
    ("snoise perlin simplex turbulence", "noise(20 mm)"),
)
_FOREIGN_NAMES = (
    ("step delta_time deltatime time_step timestep", "dt"),
    ("pi", "0.5 turn"),
    ("tau two_pi", "1 turn"),
    ("now clock elapsed", "time"),
    ("tick ticks frame_number framecount frame_count", "frame"),
)
CALL_REPLACEMENTS: dict[str, str] = {word: text for words, text in _FOREIGN_CALLS for word in words.split()}
NAME_REPLACEMENTS: dict[str, str] = {word: text for words, text in _FOREIGN_NAMES for word in words.split()}

_LETTER_PATTERN = re.compile(r"\{([a-e])\}", re.IGNORECASE)
_UNBRACKETED_NODES = (nodes.Number, nodes.Quantity, nodes.NameRef, nodes.Call, nodes.Member, nodes.Index)


def find_call_replacement(node: nodes.Call, word: str) -> tuple[str, bool] | None:
    """Return the replacement for a call that uses a word from another tool. The bool says whether it contains the arguments in
    the source.

    If the number of arguments does not match, letters stand for the arguments."""
    if word in NAME_REPLACEMENTS and not node.arguments:
        return NAME_REPLACEMENTS[word], True
    form = CALL_REPLACEMENTS.get(word)
    if form is None:
        return None
    letters = sorted({letter.lower() for letter in _LETTER_PATTERN.findall(form)})
    positional = [each for each in node.arguments if isinstance(each, nodes.Argument) and each.name is None]
    if not letters or len(positional) != len(node.arguments) or len(positional) != len(letters):
        return _LETTER_PATTERN.sub(lambda match: match[1].lower(), form), False
    texts = {letter: each for letter, each in zip(letters, positional, strict=True)}

    def find_argument_text(match: re.Match[str]) -> str:
        each = texts[match[1].lower()]
        text = " ".join(each.span.text.split())
        return f"({text})" if match[1].isupper() and not isinstance(each.value, _UNBRACKETED_NODES) else text

    return _LETTER_PATTERN.sub(find_argument_text, form), True
