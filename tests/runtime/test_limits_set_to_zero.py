"""Limits of an animal's motion that are set to 0 or below, at birth or in a run: it stands or moves as defined, on all backends
alike. What is no number is an error at the line that sets it."""

from __future__ import annotations

import meshes
import numpy as np
import pytest
from meaning import OPTION_SETS, RunHistory, crowd, item, play
from sampling import sampled

from antdsl.loading import find_library
from antdsl.runtime import MeshData
from antdsl.runtime.faults import FaultStop
from antdsl.scene.setting import FlowTarget, SpreadFlowData
from antdsl.syntax import nodes

UNITS = {
    "size": "mm", "mass": "g", "radius": "mm", "clearance": "mm", "max_speed": "mm/s", "min_speed": "mm/s", "response": "s",
    "max_turn": "deg/s", "max_force": "g * 1 mm/s^2",
}  # fmt: skip
# What an argument of a behaviour without a default is given.
ARGUMENTS_BY_TYPE = {
    "push": "heading", "place": "nearest(food)", "obstacle": "stones", "curve": "way_in", "length": "20 mm", "field": "trail",
    "flow": "drift", "angle": "40 deg",
}  # fmt: skip
WORLD = """ant 1
world {
  surface ground
  obstacle stones
  curve way_in
  flow drift
  items food { load = 10 }
}
field trail on ground { cell 8 mm; half_life 1 s }
"""


def wishes() -> list[str]:
    """A call of each behaviour of the library."""
    file = find_library("steering")
    assert file is not None
    wish_calls = []
    for each in (each for each in file.items if isinstance(each, nodes.Behaviour)):
        arguments = [ARGUMENTS_BY_TYPE[arg.type.span.text] for arg in each.arguments if arg.default is None]
        call = f"{each.name.text}({', '.join(arguments)})"
        wish_calls.append(f"rotate(heading, about: up, by: {call})" if each.returns.span.text == "angle" else call)
    return wish_calls


def play_with_limit(name: str, value: str, birth: str = "", steps: int = 7) -> RunHistory:
    """Animals with all wishes of the library, with a limit that is set to a value in their second state."""
    text = f"""use steering
species a {{
  zero = 0
  {birth}
  start walk
  state walk {{ deposit trail 1 /s; when after 0.2 s -> odd }}
  state odd {{ enter {{ {name} = {value} }}; when after 0.4 s -> again }}
  state again {{ when after 5 s -> walk }}
  layers sum {{ {"; ".join(wishes())}; state }}
}}
"""
    setting_arguments = {
        "surfaces": {"ground": MeshData(*meshes.grid(200.0, 6))},
        "obstacles": {"stones": MeshData(*meshes.box((20, -5, 20), (30, 10, 30)))},
        "curves": {"way_in": np.array([[-50.0, 0, 0], [50, 0, 10]])},
        "items": {"food": (item("f", 30, 0),)},
        "flows": {"drift": SpreadFlowData("toward", FlowTarget(np.array([[60.0, 0.0, 0.0]]), np.array([8.0])), radius=90.0)},
    }
    return play(
        text, crowd(3, radius=15), steps=steps, world=WORLD, contacts="hard", option_sets=OPTION_SETS[:3], **setting_arguments
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", UNITS)
@pytest.mark.parametrize("value", ["0", "-1"])
def test_a_limit_of_nothing_is_defined(name: str, value: str) -> None:
    birth = "min_speed 1 mm/s" if name == "min_speed" else ""
    history = play_with_limit(name, f"{value} {UNITS[name]}", birth)
    for frame in history.frames:
        assert all(
            np.isfinite(each).all() for register, each in frame["a"].items() if each.dtype.kind == "f" and register != "max_turn"
        )


@pytest.mark.parametrize("value", sampled(["0 mm/s", "-3 mm/s", "zero * 1 mm/s"], ["0 mm/s"]))
def test_who_has_no_speed_stands(value: str) -> None:
    history = play_with_limit("max_speed", value)
    assert max(np.abs(history.frames[2]["a"][f"velocity.{axis}"]).max() for axis in "xyz") > 1
    for frame in history.frames[4:]:
        assert all((frame["a"][f"velocity.{axis}"] == 0).all() for axis in "xyz")


@pytest.mark.slow
def test_who_is_born_without_speed_stands_and_may_get_some_later() -> None:
    history = play_with_limit("max_speed", "20 mm/s", birth="param slow = 0 mm/s; max_speed slow")
    born, last = history.frames[0]["a"], history.frames[-1]["a"]
    assert all((each["a"][f"velocity.{axis}"] == 0).all() for each in history.frames[:3] for axis in "xyz")
    assert (born["max_force"] == 0).all() and (last["max_speed"] == 20).all()


@pytest.mark.parametrize("name", sampled(UNITS, ["max_speed"]))
@pytest.mark.parametrize("value", sampled(["zero / zero", "-5 / zero"], ["-5 / zero"]))
def test_what_is_no_number_is_refused_where_it_is_set(name: str, value: str) -> None:
    birth = "min_speed 1 mm/s" if name == "min_speed" else ""
    if name == "max_turn" and value != "zero / zero":
        pytest.skip("an endless `max_turn` is no limit")
    with pytest.raises(FaultStop, match=rf"test.ant:\d+:23: .*`{name}` is not finite"):
        play_with_limit(name, f"({value}) * 1 {UNITS[name]}", birth, steps=5)


def test_a_fault_is_not_blamed_on_a_constant_of_another_line() -> None:
    """Where nothing is there, the nearest is endlessly far: the same constant as the `max_speed` of a species that sets none."""
    text = """species a { max_speed 20 mm/s; far = 0 mm; start go
  state go { far = distance(nearest(b)) } }
species b { start go; state go { } }
"""
    with pytest.raises(FaultStop, match=r"`far` is not finite \(distance\(nearest\(b\)\) = inf\)"):
        play(text, crowd(2), steps=3, option_sets=OPTION_SETS[:1])
