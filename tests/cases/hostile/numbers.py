"""Programs with numbers that go wrong: N2 to N5 and N8 to N13. What is not finite reaches no agent: it is a fault with its
place."""

from __future__ import annotations

from cases.hostile.rows import PROGRAM, Row, named


def program(
    name: str, attributes: str, state: str, frames: int = 4, faults: bool = False, verdict: str = "", words: str = ""
) -> Row:
    """The walkers with more attributes, and more in their only state."""
    text = PROGRAM.decode().replace("  start stroll", f"  {attributes}\n  start stroll")
    text = text.replace("steer wander(swing: 40 deg)", f"\n    steer wander(swing: 40 deg)\n    {state}\n ")
    return Row(name, verdict, words, {"walker.ant": text.encode()}, warned=True, frames=frames, faults=faults)


ROWS = [
    program("N1 x / 0", "n = 0", "n = 1 / n", faults=True),
    program("N1 0 / 0", "n = 0", "n = n / n", faults=True),
    program("N1 log 0", "n = 0", "n = log(n)", faults=True),
    program("N1 the root of -1", "n = 0", "n = sqrt(n - 1)", faults=True),
    program("N1 0 to the power of -1", "n = 0", "n = n ^ (0 - 1)", faults=True),
    program(
        "N2 nan in a guard is false", "n = 0\n  hit = 0", "when n / n > 1 -> other\n  }\n  state other red {\n    hit = 1 / n"
    ),
    program("N2 nan in not a guard", "n = 0\n  hit = 0", "when not (n / n > 1) -> other\n  }\n  state other red {\n    hit = 1"),
    program("N2 nan in the least of two", "n = 0\n  m = 0", "m = min(n / n, 1)"),
    program("N2 nan in a clamp", "n = 0\n  m = 0", "m = clamp(n / n, 0 .. 1)"),
    program("N3 a place that is not finite in a wish", "n = 0", "steer seek(vector(1 mm, 0 mm, 0 mm) / n)"),
    program("N5 a number beyond 2^31", "n = 2000000000", "n = n * 2 + 1", frames=6),
    program("N5 a number beyond float32", "n = 1e30", "n = n * n", faults=True),
    program("N8 a branch that is not taken divides by 0", "n = 0\n  m = 0", "m = if n > 0 then 1 / n else 2"),
    program("N8 both sides of or", "n = 0\n  m = 0", "when n > 0 and 1 / n > 2 -> stroll\n    m = 1"),
    program("N9 numbers too small to be whole", "n = 1", "n = n * 1e-30", frames=6),
    program("N10 everyone dies", "n = 0", "when after 2 step -> gone { die }\n  }\n  state gone red {\n    n = 1", frames=6),
    Row("N10 nobody from the start", "", edits={"scene.yaml": ("count: 20", "count: 0")}, frames=6),
    Row("N4 the ground 5,000 km out", "bad-mesh", "1000 km", edits=named("ground.ply", ", at: [5000000 m, 0, 0]")),
    Row("N4 the ground 50 km out", "", edits=named("ground.ply", ", at: [50000 m, 0, 0]"), frames=4),
    Row("N7 frames a second of 0", "wrong-value", "", edits={"scene.yaml": ("fps: 24", "fps: 0")}),
    Row("N7 no substeps", "wrong-value", "", edits={"scene.yaml": ("fps: 24", "fps: 24\nsubsteps: 0")}),
]
