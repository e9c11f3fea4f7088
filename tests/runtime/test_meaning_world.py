"""Senses, sets, wishes, births and deaths: small programs on the real runtime, on both backends, against what their text says."""

from __future__ import annotations

import math

import meshes
import numpy as np
import pytest
from meaning import FAST, crowd, item, play

from antdsl import limits
from antdsl.runtime import FaultStop, FieldStartData, MeshData, Options

IDLE = "start idle\nstate idle { when false -> busy }\nstate busy { when false -> idle }\n"
STILL = "on spawn { velocity = vector(0 mm/s, 0 mm/s, 0 mm/s); heading = vector(1, 0, 0) }\n"
GROUND = {"ground": MeshData(*meshes.grid(400.0, 10))}


def values(expressions: dict[str, str], *crowds, attributes: str = "", steps: int = 1, **setting):
    """Numbers that the agents of one species work out in a step, standing still and facing along x."""
    lines = "".join(f"{name} = 0\n" for name in expressions)
    body = "; ".join(f"{name} = {text}" for name, text in expressions.items())
    text = f"species a {{ {attributes}\n{lines}{STILL}start s\n"
    text += f"state s {{ {body}; when false -> t }}\nstate t {{ when false -> s }} }}"
    return play(text, *crowds, steps=steps, **setting)


# --- sets -------------------------------------------------------------------------------------------------------------

LINE = crowd(at=[(0, 0), (3, 0), (7, 0), (20, 0), (0, 4)])


def test_reductions_over_neighbours():
    expressions = {
        "how_many": "count(neighbours(8 mm))",
        "far_ones": "count(n in neighbours(8 mm): distance(n) > 3.5 mm)",
        "some": "if any(n in neighbours(8 mm): n.weight > 3) then 1 else 0",
        "all_of": "if every(n in neighbours(8 mm): n.weight > 0) then 1 else 0",
        "added": "sum(n in neighbours(8 mm): n.weight)",
        "middle": "mean(n in neighbours(8 mm): n.weight)",
        "least": "min(99, min(n in neighbours(8 mm): n.weight))",
        "most": "max(-1, max(n in neighbours(8 mm): n.weight))",
        "ahead": "count(neighbours(8 mm, 90 deg))",
        "heaviest": "best(n in neighbours(8 mm): n.weight).weight",
        "closest_one": "nearest(neighbours(8 mm)).weight",
        "everybody": "count(n in a: n.weight >= 0)",
    }
    history = values(expressions, LINE, attributes="weight = id")
    # which agents see which within 8 mm: 0: 1 2 4; 1: 0 2 4 (5 mm); 2: 0 1 (4 is 8.06 away); 3: none; 4: 0 1
    assert history["how_many"] == [3, 3, 2, 0, 2]
    assert history["far_ones"] == [2, 2, 2, 0, 2]
    assert history["some"] == [1, 1, 0, 0, 0]
    assert history["all_of"] == [1, 0, 0, 1, 0]
    assert history["added"] == [7, 6, 1, 0, 1]
    assert history["middle"] == pytest.approx([7 / 3, 2, 0.5, 0, 0.5])
    assert history["least"] == [1, 0, 0, 99, 0] and history["most"] == [4, 4, 1, -1, 1]
    assert history["ahead"] == [2, 1, 0, 0, 0]
    assert history["heaviest"] == [4, 4, 1, 0, 1] and history["closest_one"] == [1, 0, 1, 0, 0]
    assert history["everybody"] == [4] * 5


def test_items_by_place_and_by_condition():
    food = (item("f", 10, 0, 2, load=0), item("g", 30, 0, 2, load=4), item("h", 50, 0, 2, load=9))
    history = values(
        {
            "any_way": "distance(nearest(food)) / 1 mm",
            "full": "distance(nearest(food, with: load > 0)) / 1 mm",
            "within": "if nearest(food, with: load > 0, within: 20 mm) then 1 else 0",
            "by_it": "nearest(food, with: distance(it) > 35 mm).load",
            "fattest": "best(f in all(food): f.load).load",
            "stock": "sum(f in all(food, within: 35 mm): f.load)",
            "none_load": "nearest(food, within: 1 mm).load + 1",
            "touch": "if touching(food) then 1 else 0",
            "shade": "falloff(nearest(food), floor: 5 mm)",
            "nowhere": "falloff(nearest(food, within: 1 mm), floor: 5 mm) + length(direction(nearest(food, within: 1 mm)))",
            "endless": "if distance(nearest(food, within: 1 mm)) > 1000000 m then 1 else 0",
            "way": "dot(direction(nearest(food, with: load > 5)), heading)",
            "between": "dot(direction(nearest(food), to: best(f in all(food): f.load)), heading)",
            "second": "first(nearest(food, within: 1 mm), nearest(food, with: load > 0)).load",
        },
        crowd(at=[(0, 0), (8, 0)]),
        items={"food": food},
    )
    expected = {
        "any_way": [10, 2], "full": [30, 22], "within": [0, 0], "by_it": [9, 9], "fattest": [9, 9], "stock": [4, 4],
        "none_load": [1, 1], "touch": [0, 1], "shade": [0.5, 1], "nowhere": [0, 0], "endless": [1, 1], "way": [1, 1],
        "between": [1, 1], "second": [4, 4],
    }  # fmt: skip
    assert {name: pytest.approx(history[name]) for name in expected} == expected


def test_rays_feelers_touching_and_slope():
    rock = meshes.box((10, -5, -50), (20, 5, 50))
    history = values(
        {
            "straight": "ray(heading, reach: 30 mm, on: stones).distance / 1 mm",
            "facing": "dot(ray(heading, reach: 30 mm, on: stones).normal, heading)",
            "short": "if ray(heading, reach: 5 mm, on: stones) then 1 else 0",
            "feel": "count(feelers(stones, count: 3, spread: 45 deg, reach: 12 mm))",
            "all_feel": "count(feelers(stones, count: 3, spread: 45 deg, reach: 16 mm))",
            "mean_way": "mean(h in feelers(stones, count: 3, spread: 45 deg, reach: 16 mm): h.distance) / 1 mm",
            "against": "if touching(stones) then 1 else 0",
            "stands": "if touching(ground) then 1 else 0",
            "room": "distance(stones) / 1 mm",
            "flat": "slope / 1 deg",
        },
        crowd(at=[(0, 0), (9, 0)]),
        surfaces=GROUND,
        obstacles={"stones": MeshData(*rock)},
    )
    assert history["straight"] == pytest.approx([10, 1]) and history["facing"] == pytest.approx([-1, -1])
    assert history["short"] == [0, 1] and history["feel"] == [1, 3] and history["all_feel"] == [3, 3]
    assert history["mean_way"] == pytest.approx([(10 + 20 * math.sqrt(2)) / 3, (1 + 2 * math.sqrt(2)) / 3], rel=1e-4)
    assert (history["against"], history["stands"]) == ([0, 1], [1, 1])
    assert history["room"] == pytest.approx([10, 1]) and history["flat"] == pytest.approx([0, 0], abs=1e-3)


def test_curves_and_numbers_of_the_run():
    road = np.array([[0.0, 0, 10], [100, 0, 10]])
    history = values(
        {
            "off": "distance(way_in) / 1 mm",
            "along": "dot(tangent(way_in), heading)",
            "side": "dot(closest(way_in) - position, vector(0, 0, 1)) / 1 mm",
            "now": "time / 1 s * 10 + frame",
            "mixed": "mix(2, 6, 0.25) + ramp(15 mm, from: 10 mm .. 20 mm, to: 0 .. 4) + (if 1 > 2 then 5 else 7)",
            "turned": "angle(rotate(heading, about: up, by: 30 deg), heading) / 1 deg",
        },
        crowd(at=[(50, 0)]),
        curves={"way_in": road},
        first_frame=4,
        steps=3,
    )
    assert (history["off"], history["along"], history["side"]) == (pytest.approx([10]), pytest.approx([1]), pytest.approx([10]))
    assert (
        history["now"] == pytest.approx([7 + 7])
        and history["mixed"] == [12]
        and history["turned"] == pytest.approx([30], rel=1e-4)
    )


# --- fields -----------------------------------------------------------------------------------------------------------

FIELDS = """ant 1
world { surface ground }
field half on ground { cell 10 mm; half_life 1 s }
field kept on ground { cell 10 mm; keeps 90 %/step }
field gone on ground { cell 10 mm; evaporate 50 %/s }
field most on ground { cell 10 mm; combine max }
field full on ground { cell 10 mm; limit 5 }
field wide on ground { cell 10 mm; diffuse 100 mm^2/s }
field soon on ground { cell 10 mm; diffuse 100 mm^2/s; stencil 8; deposits first }
"""


def test_what_is_laid_is_there_whole_in_the_next_step_and_fades_from_then_on():
    names = ("half", "kept", "gone", "most", "full", "wide", "soon")
    text = f"species a {{ {STILL}" + "".join(f"x{n} = 0\n" for n in names)
    reads = "; ".join(f"x{n} = {n}" for n in names)
    lays = "; ".join(f"deposit {n} {'1 + id' if n == 'most' else 4}" for n in names)
    text += f"start p\nstate p {{ {reads}; when frame == 3 -> q {{ {lays} }} }}\nstate q {{ {reads}; when false -> p }} }}"
    history = play(text, crowd(3), steps=14, world=FIELDS, surfaces=GROUND)
    first, last = ({n: history.every(f"x{n}")[k] for n in names} for k in (4, 14))
    assert first.pop("soon") == pytest.approx(12 * (1 - 20 / 6 * 100 * 0.1 / 100), rel=1e-5)
    assert first == {"half": 12, "kept": 12, "gone": 12, "most": 3, "full": 5, "wide": 12}
    assert all(history.every(f"x{n}")[3] == 0 for n in names)
    assert last["half"] == pytest.approx(6) and last["kept"] == pytest.approx(12 * 0.9**10)
    assert last["gone"] == pytest.approx(12 * math.exp(-0.5), rel=1e-5) and last["full"] == 5
    assert history.every("xwide")[5] == pytest.approx(12 * (1 - 4 * 100 * 0.1 / 100), rel=1e-5)


def test_a_field_has_a_starting_value_also_for_those_just_born():
    text = """species a { seen = 0
on spawn { seen = half }
start p
state p { when frame == 3 -> q { spawn a } }
state q { when age > 100 s -> p } }"""
    history = play(text, crowd(2, at=[(0, 0), (90, 0)]), steps=4, world=FIELDS, surfaces=GROUND,
                field_start={"half": (FieldStartData(2.0, (0.0, 0.0, 0.0), 50.0),)})  # fmt: skip
    assert history["seen"] == pytest.approx([2, 0, 2 * 2**-0.3, 0])


# --- wishes -----------------------------------------------------------------------------------------------------------


def pushes(layers: str, behaviours: str = "", order: list[str] | None = None):
    text = f"{behaviours}species a {{ {STILL}start s\nstate s {{ steer vector(0.5, 0, 0); when false -> t }}\n"
    text += f"state t {{ when false -> s }}\nlayers {layers} }}"
    history = play(text, steps=1, orders=None if order is None else {"a": order})
    return [history[f"push.{axis}"][0] for axis in "xz"]


def test_a_push_is_cut_to_what_is_left():
    north, south = "vector(0, 0, 0.8)", "vector(0, 0, -0.9)"
    assert pushes(f"{{ {north}; state; {south} }}") == pytest.approx([0.2, 0.8])
    assert pushes(f"{{ state; {north}; {south} }}") == pytest.approx([0.5, 0.5])
    assert pushes(f"{{ state; {north} when frame > 6; {south} }}") == pytest.approx([0.5, -0.5])
    assert pushes("{ vector(0, 0, 3); state }") == pytest.approx([0, 1])
    assert pushes(f"first {{ vector(0, 0, 0); {north}; state }}") == pytest.approx([0, 0.8])
    assert pushes("sum { vector(0, 0, 0.1); state }") == pytest.approx([0.5, 0.1])
    length = math.hypot(0.5, 0.8)
    assert pushes(f"sum {{ {north}; state }}") == pytest.approx([0.5, 0.8] if length <= 1 else [0.5 / length, 0.8 / length])
    assert pushes("sum { vector(0, 0, 3); state }") == pytest.approx([0.5 / math.hypot(0.5, 3), 3 / math.hypot(0.5, 3)])


def test_a_scene_may_reorder_the_layers():
    behaviours = "behaviour north() -> push { vector(0, 0, 0.8) }\n"
    assert pushes("{ north(); state }", behaviours) == pytest.approx([0.2, 0.8])
    assert pushes("{ north(); state }", behaviours, ["state", "north"]) == pytest.approx([0.5, 0.5])


@pytest.mark.parametrize("substeps", [1, 3])
def test_limits_of_speed_and_turn_and_a_kinematic_animal(substeps):
    text = f"""species a {{ {STILL}response 1 step
max_speed 20 mm/s
start s
state s {{ steer match(vector(0 mm/s, 0 mm/s, -50 mm/s)); when false -> t }}
state t {{ when false -> s }} }}
species b {{ max_turn 90 deg/s
response 1 step
max_speed 20 mm/s
on spawn {{ velocity = vector(20 mm/s, 0 mm/s, 0 mm/s); heading = vector(1, 0, 0) }}
start s
state s {{ steer match(vector(0 mm/s, 0 mm/s, -20 mm/s)); when false -> t }}
state t {{ when false -> s }} }}"""
    history = play(text, crowd(), crowd(species="b"), steps=5, substeps=substeps)
    assert [history.at(f"velocity.{a}", 1)[0] for a in "xz"] == pytest.approx([0, -20], abs=1e-4)
    angles = [
        math.degrees(math.atan2(-history.at("velocity.z", k, "b")[0], history.at("velocity.x", k, "b")[0])) for k in range(6)
    ]
    assert angles == pytest.approx([0, 9, 18, 27, 36, 45], abs=0.1)


def test_velocity_and_heading_are_set_in_enter_and_in_handlers():
    text = """species a { response 1 step
max_speed 50 mm/s
on spawn { velocity = vector(0 mm/s, 0 mm/s, 0 mm/s) }
on ping { velocity = vector(0 mm/s, 0 mm/s, 7 mm/s) }
start s
state s { when frame == 2 -> t { emit ping } }
state t { enter { velocity = vector(5 mm/s, 0 mm/s, 0 mm/s); heading = vector(0, 0, 4) }; when false -> s } }"""
    history = play(text, steps=4)
    assert history.every("velocity.x") == pytest.approx([0, 0, 5, 0, 0])
    assert history.every("velocity.z") == pytest.approx([0, 0, 0, 7, 7])
    assert history.every("position.x")[-1] == pytest.approx(history.every("position.x")[0] + 0.5)


# --- births and deaths ------------------------------------------------------------------------------------------------


def test_those_born_together_see_each_other_alike_and_the_others_as_they_are():
    text = """species a { size uniform(3 mm, 5 mm)
m = 1 + id
at_birth = age / 1 s
others = sum(n in neighbours(500 mm): n.m)
seen = 0
now = 0
start p
on spawn { seen = count(neighbours(500 mm)) }
state p {
  now = count(neighbours(500 mm))
  when frame == 3 and id < 4 -> q { die }
  when frame == 3 and id == 5 -> q { spawn a; spawn a }
}
state q { when age > 100 s -> p } }"""
    history = play(text, crowd(10, radius=5, group=3), steps=4)
    assert history["id"] == [4, 5, 6, 7, 8, 9, 10, 11]
    assert history["seen"] == [9] * 6 + [7] * 2 and history["others"] == [0] * 6 + [5 + 6 + 7 + 8 + 9 + 10] * 2
    assert history["at_birth"] == [0] * 8 and history["group"] == [3] * 8 and history["now"] == [7, 9] + [7] * 6


def test_who_dies_at_birth_has_given_and_raised_what_it_said_before():
    text = """field trail on ground { cell 8 mm }
species a { load = 1
start p
state p { enter { give all load to nest; emit ping(within: 500 mm); deposit trail 1; die }; when age > 100 s -> q }
state q { when age > 100 s -> p } }
species b { heard = 0
on ping { heard += 1 }
start p
state p { when age > 100 s -> q }
state q { when age > 100 s -> p } }"""
    setting_arguments = {"surfaces": {"ground": MeshData(*meshes.terrain(100.0, 4))}, "items": {"nest": (item("n", 0, 0),)}}
    history = play(text, crowd(3, radius=5), crowd(2, species="b", radius=5), steps=1, **setting_arguments)
    assert history.at("id", 0) == [] and history.amounts("nest") == [3] and history.at("heard", 1, "b") == [1, 1]
    assert history.world.fields["trail"].amounts.sum() == 3


def test_references_to_the_dead_become_none_and_all_may_die():
    text = """species a {
pal = none of a
had = none of a
has = 0
start p
on spawn { pal = nearest(a); had = random(a) }
state p { has = if pal then 1 + distance(pal) / 1 mm else 0
  when frame == 3 and id >= 2 or frame == 5 -> q { die } }
state q { when age > 100 s -> p } }
species b { prey = none of a
on spawn { prey = nearest(a) }
start hunt
state hunt { when no prey -> rest }
state rest { when nearest(a) -> hunt } }"""
    history = play(text, crowd(at=[(0, 0), (9, 0), (5, 0)]), crowd(species="b", at=[(6, 0), (0, 1)]), steps=7)
    assert history.at("pal", 0) == [2, 2, 1] and history.at("pal", 3) == [-1, -1]
    assert history.at("has", 3)[0] > 1 and history.at("has", 4) == [0, 0] and -1 not in history.at("had", 0)
    assert history.at("prey", 2, "b") == [2, 0] and history.at("prey", 3, "b") == [-1, 0]
    assert [history.at("main.state", k, "b") for k in (3, 4, 5)] == [[0, 0], [1, 0], [0, 0]]
    assert history["id"] == [] and history.at("main.state", -1, "b") == [1, 1]


def test_a_spawn_in_each_step_stops_at_the_cap(monkeypatch):
    monkeypatch.setattr(limits, "MAX_AGENTS", 20)
    text = "species a { start p\nstate p { when true -> q { spawn a } }\nstate q { when true -> p { spawn a } } }"
    history = play(text, crowd(1), steps=7)
    assert [len(frame["a"]["id"]) for frame in history.frames] == [1, 2, 4, 8, 16, 20, 20, 20]
    assert history.world.faults.rejected_births == 12 + 20 + 20 and history["id"] == list(range(20))


@pytest.mark.parametrize("count", [0, 1, 2])
def test_no_one_and_two_agents_on_a_point(count):
    history = values(
        {
            "near": "count(neighbours(10 mm))",
            "way": "length(sum(n in neighbours(10 mm): direction(n, to: self)))",
            "off": "min(n in neighbours(10 mm): distance(n)) / 1 mm + 0" if count == 2 else "0",
        },
        crowd(count),
        steps=2,
    )
    assert history["near"] == [count - 1] * count and history["way"] == [0] * count and history["off"] == [0] * count


# --- faults -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "what", "operand"),
    [
        ("x = 1 / (size / 1 mm - 4)", "x", "size / 1 mm - 4"),
        ("v = heading / (size / 1 mm - 4)", "v", "size / 1 mm - 4"),
        ("steer heading / (size / 1 mm - 4)", "steer", "size / 1 mm - 4"),
        ("x = sqrt(-size / 1 mm)", "x", "-size / 1 mm"),
        ("x += log(-size / 1 mm) / 1 s", "x", "-size / 1 mm"),
    ],
)
def test_a_fault_is_reported_in_the_words_of_the_text_and_nothing_is_stored(line, what, operand):
    text = f"species a {{ x = 7\nv = vector(0, 0, 0)\nstart s\nstate s {{ {line}; when false -> t }}\n"
    text += "state t { when false -> s } }"
    for options in (Options(), Options(backend="reference")):
        with pytest.raises(FaultStop) as stop:
            play(text, crowd(3), steps=2, option_sets=[options])
        fault = stop.value.fault
        assert (fault.value_name, fault.agent, fault.frame) == (what, 0, 1) and fault.span.text in line
        assert any(operand in text.strip("()") for text, _ in fault.operands), fault
    option_sets = [Options(on_fault="quarantine"), Options(on_fault="quarantine", backend="reference", shuffle_rows=1)]
    history = play(text, crowd(3), steps=3, option_sets=option_sets)
    assert (
        history["x"] == [7, 7, 7] and history.world.faults.fault_count == 3 and history.world.populations["a"].quarantined.all()
    )


def test_a_fault_at_birth_names_the_agent_that_was_born():
    text = """species a { x = 0
on spawn { x = 1 / (id - 3) }
start p
state p { when frame == 3 and id == 1 -> q { spawn a } }
state q { when age > 100 s -> p } }"""
    for options in (Options(), Options(backend="reference", shuffle_rows=1)):
        with pytest.raises(FaultStop) as stop:
            play(text, crowd(3), steps=6, option_sets=[options])
        assert (stop.value.fault.agent, stop.value.fault.frame, stop.value.fault.value_name) == (3, 3, "x")
        assert ("(id - 3)", "0") in stop.value.fault.operands


def test_a_condition_that_is_no_number_is_false():
    text = """species a { x = 0
start s
state s { x = count(n in neighbours(50 mm): sqrt(-n.size / 1 mm) > 0)
  when sqrt(-size / 1 mm) > 0 -> t
  when not (sqrt(-size / 1 mm) > 0) -> u }
state t { when false -> s }
state u { when false -> s } }"""
    history = play(text, crowd(4, radius=5), steps=2)
    assert history["main.state"] == [2] * 4 and history["x"] == [0] * 4


# --- decision 22 ------------------------------------------------------------------------------------------------------

STROLL = """use steering
species a { param dash = 20 mm/s in 1 mm/s .. 90 mm/s
max_speed dash
luck = uniform(0, 1)
start go
state go { steer wander(); luck = luck + normal(0, 1) * 0.01; when chance 20 %/s -> rest }
state rest { steer halt(); when after uniform(0.2 s, 0.6 s) -> go } }
"""


def test_more_agents_and_another_species_change_nothing_for_the_others():
    alone = play(STROLL, crowd(12, radius=50), steps=12, seed=5, option_sets=FAST)
    larger = play(STROLL, crowd(30, radius=50), steps=12, seed=5, option_sets=FAST)
    text = STROLL + f"species b {{ {IDLE} }}\n"
    other = play(text, crowd(5, species="b", radius=50), crowd(12, radius=50), steps=12, seed=5, option_sets=FAST)
    for register in ("position.x", "velocity.z", "heading.x", "luck", "main.state", "main.time_in_state"):
        assert larger[register][:12] == alone[register] == other[register]
    assert len(set(alone["main.state"])) == 2
    fast = play(STROLL, crowd(12, radius=50), steps=12, seed=5, option_sets=FAST, params={"a.dash": 40.0})
    assert fast["luck"] == alone["luck"] and fast["position.x"] != alone["position.x"]
