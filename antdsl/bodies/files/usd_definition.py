"""A USD file as an agent definition, requested from the reader and checked."""

from __future__ import annotations

from fractions import Fraction

from antdsl.bodies.agents.definition import BodyError, Definition
from antdsl.bodies.agents.packed import PARTS, unpack_definition
from antdsl.reader.protocol import ProtocolError, Refusal, display_text
from antdsl.scene.geometry.usd import UsdError, open_stage
from antdsl.scene.paths import Roots

_SENTENCES = 10_000


def read_usd(roots: Roots, text: str, prim: str, name: str, rate: float) -> tuple[Definition, list[str]]:
    """Return the definition at and below a prim of a file, and sentences about what is not read. `rate`: samples per second of
    its animations, 0 for the stage's own. Raises UsdError or BodyError if there is none."""
    stage = open_stage(roots, text, prim, up="y", frames=range(1), fps=Fraction(24))
    try:
        answer = stage.ask("usd-body", {"name": name, "rate": rate})
        left_out = [display_text(sentence) for sentence in answer.texts("left_out", _SENTENCES)]
        if set(answer.arrays) != set(PARTS):
            raise ProtocolError("a part of the body is missing")
    except UsdError:
        raise
    except Refusal as why:
        raise BodyError(str(why), why.help, why.code) from None
    except ProtocolError as why:
        raise stage.make_answer_error(why) from None
    return unpack_definition(answer.arrays), left_out
