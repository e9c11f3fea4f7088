"""Random programs with species that die out and are born again: those of `random_sensing`, with an end to each life and eggs."""

from __future__ import annotations

import random_sensing

EGG = """species egg {{
  laid = 0
  start wait
  state wait {{
    when laid < {most} and age > {first} s + laid * {every} s -> lay {{ laid += 1; spawn {one}; spawn {other} }}
  }}
  state lay {{ when after 0.1 s -> wait }}
}}
"""


class Vanishing(random_sensing.Sensing):
    """`text` is a program with the species `a`, `other` and `egg`: the first two die of age, all at about the same time."""

    def _program(self) -> str:
        text, rng = super()._program(), self.rng
        life, end = rng.choice((0.2, 0.4, 0.6)), rng.choice((0.2, 0.4, 0.6))
        for old, new in (
            ("machine moving {\nstart p\n", f"machine moving {{\nstart p\nfrom any when age > {life} s -> r {{ die }}\n"),
            ("state go { steer wander();", f"state go {{ steer wander(); when age > {end} s -> stop {{ die }};"),
            ("state stop { mood += 10 %/s;", f"state stop {{ mood += 10 %/s; when age > {end} s -> go {{ die }};"),
        ):
            assert old in text
            text = text.replace(old, new)
        one, other = rng.choice((("a", "other"), ("a", "a"), ("other", "other")))
        return text + EGG.format(
            most=rng.choice((0, 1, 3)), first=rng.choice((0.1, 0.8)), every=rng.choice((0.3, 0.9)), one=one, other=other
        )
