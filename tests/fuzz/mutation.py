"""Changes to an input: bytes, lines, words and numbers. Each mutator takes a random generator, the input and another input of the
pool, and returns a changed input. The same generator state gives the same result."""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Sequence

Mutator = Callable[[random.Random, bytes, bytes], bytes]

NUMBERS = (
    b"nan", b"-inf", b".inf", b"1e999", b"-1", b"0", b"-0.0", b"1e-320", b"3.1e38", b"1e300", b"255", b"256", b"65536",
    b"2147483648", b"4294967295", b"9223372036854775807", b"18446744073709551616", b"9" * 60, b"0x10", b"1_0", b"0.1", b"2.5",
)  # fmt: skip
ODD = (
    b"\xff\xfe", b"\xc3\x28", b"\xef\xbb\xbf", b"\xed\xa0\x80", b"\0", b"\x1b[2J", b"\xc2\xa0", b"\xe2\x80\xa8", b"\xe2\x80\xae",
    "х".encode(), "９".encode(), b"%s{0.__class__}", b"$(id)", b"../../etc/passwd", b"/etc/passwd", b"\xf0\x9f\x90\x9c",
)  # fmt: skip
LINE_ENDS = (b"\r\n", b"\r", b"\n\n", b"\\\n", b" " * 500 + b"\n", b"\xe2\x80\xa8")
REPEATS = (1, 1, 2, 8, 300)
_WORD = re.compile(rb"[A-Za-z_][A-Za-z_0-9]*")
_NUMBER = re.compile(rb"-?[0-9]+(?:\.[0-9]+)?(?:[eE][+-]?[0-9]+)?")
_TOKEN = re.compile(rb"[A-Za-z_][A-Za-z_0-9]*|[0-9.]+|[^\sA-Za-z_0-9]|\n|[ \t]+")


def flip_bit(rng: random.Random, data: bytes, other: bytes) -> bytes:
    """One bit turned over."""
    if not data:
        return b"\0"
    changed = bytearray(data)
    changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def cut_end(rng: random.Random, data: bytes, other: bytes) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def remove_part(rng: random.Random, data: bytes, other: bytes) -> bytes:
    at = rng.randrange(len(data) + 1)
    return data[:at] + data[at + rng.randrange(1, 60) :]


def repeat_part(rng: random.Random, data: bytes, other: bytes) -> bytes:
    at = rng.randrange(len(data) + 1)
    return data[:at] + data[at : at + rng.randrange(1, 200)] * rng.choice(REPEATS) + data[at:]


def insert_bytes(rng: random.Random, data: bytes, other: bytes) -> bytes:
    at = rng.randrange(len(data) + 1)
    return data[:at] + (rng.choice(ODD) if rng.random() < 0.5 else rng.randbytes(rng.randrange(1, 30))) + data[at:]


def overwrite_field(rng: random.Random, data: bytes, other: bytes) -> bytes:
    """An aligned or unaligned integer of a binary format set to a value at an edge."""
    size = rng.choice((1, 2, 4, 8))
    if len(data) < size:
        return data
    value = rng.choice(
        (0, 1, (1 << 8 * size) - 1, 1 << (8 * size - 1), (1 << (8 * size - 1)) - 1, rng.randrange(1 << 8 * size), 3)
    )
    at = rng.randrange(len(data) - size + 1)
    return data[:at] + value.to_bytes(size, rng.choice(("little", "big"))) + data[at + size :]


def splice(rng: random.Random, data: bytes, other: bytes) -> bytes:
    """The beginning of one input and the end of another."""
    return data[: rng.randrange(len(data) + 1)] + other[rng.randrange(len(other) + 1) :]


def change_number(rng: random.Random, data: bytes, other: bytes) -> bytes:
    return _replace_match(rng, data, _NUMBER, rng.choice(NUMBERS))


def swap_word(rng: random.Random, data: bytes, other: bytes) -> bytes:
    """A word replaced by a word of the same or another input."""
    words = _WORD.findall(data if rng.random() < 0.5 else other)
    return _replace_match(rng, data, _WORD, rng.choice(words)) if words else data


def move_token(rng: random.Random, data: bytes, other: bytes) -> bytes:
    """A token removed, doubled, or exchanged with another one."""
    tokens = _TOKEN.findall(data)
    if len(tokens) < 2:
        return data
    one, two = rng.randrange(len(tokens)), rng.randrange(len(tokens))
    kind = rng.randrange(3)
    if kind == 0:
        del tokens[one : one + rng.choice((1, 1, 2, 5))]
    elif kind == 1:
        tokens[one:one] = [tokens[two]] * rng.choice(REPEATS)
    else:
        tokens[one], tokens[two] = tokens[two], tokens[one]
    return b"".join(tokens)


def move_lines(rng: random.Random, data: bytes, other: bytes) -> bytes:
    """A run of lines removed, doubled, moved, or taken from another input."""
    lines = data.split(b"\n")
    at, size = rng.randrange(len(lines)), rng.choice((1, 1, 2, 4, 9))
    kind = rng.randrange(5)
    if kind == 0:
        del lines[at : at + size]
    elif kind == 1:
        lines[at:at] = lines[at : at + size] * rng.choice(REPEATS)
    elif kind == 2:
        part = lines[at : at + size]
        del lines[at : at + size]
        to = rng.randrange(len(lines) + 1)
        lines[to:to] = part
    else:
        others = other.split(b"\n")
        start = rng.randrange(len(others))
        lines[at : at + (size if kind == 3 else 0)] = others[start : start + size]
    return b"\n".join(lines)


def change_line_ends(rng: random.Random, data: bytes, other: bytes) -> bytes:
    return data.replace(b"\n", rng.choice(LINE_ENDS), rng.choice((1, -1)))


def nest(rng: random.Random, data: bytes, other: bytes) -> bytes:
    """A part put into brackets, many times."""
    opening, closing = rng.choice((b"()", b"[]", b"{}", b"<>", b'""', b"''")).decode()
    count = rng.choice((1, 2, 40, 70, 300, 5000))
    at = rng.randrange(len(data) + 1)
    to = min(len(data), at + rng.randrange(40))
    return data[:at] + opening.encode() * count + data[at:to] + closing.encode() * rng.choice((count, count, 0)) + data[to:]


def _replace_match(rng: random.Random, data: bytes, pattern: re.Pattern[bytes], value: bytes) -> bytes:
    matches = list(pattern.finditer(data))
    if not matches:
        return data
    one = rng.choice(matches)
    return data[: one.start()] + value + data[one.end() :]


def insert_words(words: Sequence[bytes]) -> Mutator:
    """A mutator that replaces a word by one of a vocabulary, or inserts one."""

    def mutate(rng: random.Random, data: bytes, other: bytes) -> bytes:
        word = rng.choice(words)
        if rng.random() < 0.6:
            return _replace_match(rng, data, _WORD, word)
        spaces = [at for at in range(len(data)) if data[at] in b" \n"] or [len(data)]
        at = rng.choice(spaces)
        return data[:at] + b" " + word + data[at:]

    return mutate


BYTES: tuple[Mutator, ...] = (flip_bit, cut_end, remove_part, repeat_part, insert_bytes, overwrite_field, splice)
TEXT: tuple[Mutator, ...] = (
    flip_bit, cut_end, remove_part, repeat_part, insert_bytes, splice, change_number, change_number, swap_word, swap_word,
    move_token, move_token, move_lines, move_lines, change_line_ends, nest,
)  # fmt: skip
BINARY: tuple[Mutator, ...] = (*BYTES, overwrite_field, overwrite_field, change_number, change_line_ends, nest)


def mutate(rng: random.Random, mutators: Sequence[Mutator], pool: Sequence[bytes], cap: int) -> bytes:
    """An input of the pool with one to four changes, no longer than `cap` bytes."""
    data = rng.choice(pool)
    for _ in range(rng.choice((1, 1, 2, 2, 3, 4))):
        data = rng.choice(mutators)(rng, data, rng.choice(pool))[:cap]
    return data
