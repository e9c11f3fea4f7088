"""Assembles a proposal: a definition file in which a comment above each guess states the reason for it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import Definition, to_language_name
from antdsl.bodies.files.document_values import format_axis
from antdsl.bodies.proposing.joint_motion import find_posed_points
from antdsl.bodies.proposing.leg_search import LegCandidate, is_below
from antdsl.bodies.proposing.study import IDLE_WORDS, MIN_STILL_SHARE, BodyMeasurements, measure_body
from antdsl.scene.scene_model import UNIT_MM

Floats = NDArray[np.float64]
_PLAUSIBLE_HEIGHT_MM = (2.0, 4000.0)  # mm; of an animal or a person
_UNIT_WORDS = ("m", "cm", "mm")
_GAIT_WORDS = ("walk", "run", "trot", "gallop", "jog", "sprint", "hop", "crawl", "march")
# a name that contains no information
_UNINFORMATIVE_NAME_PATTERN = re.compile(r"(?:clip|anim|animation|action|take|armature|mixamo\.com|[\W_\d])*", re.IGNORECASE)
_MIN_UPRIGHT_RATIO = 1.5  # ratio of height to length; above it, a body stands upright
_TRUNK_LENGTH_SHARE = 0.96  # share of the trunk's points that its capsule contains along each axis
_GRAVITY_MM = 9810.0
_WALK_FROUDE, _WALK_STRIDE, _WALK_DUTY, _WALK_LIFT = 0.16, 1.4, 0.62, 0.1  # values of a normal walk, in leg lengths


@dataclass(slots=True, eq=False)
class BodyFileProposal:
    """A proposed definition.

    `entries`: the keys of the file with their values, in order.
    `reasons`: the reasons for each value by key; "" has the reasons for the file."""

    entries: dict[str, Any] = field(default_factory=dict)
    reasons: dict[str, list[str]] = field(default_factory=dict)

    def add_entry(self, key: str, value: Any, *reasons: str) -> None:
        """Add a key to the file with its value, and the reasons for this value."""
        self.entries[key] = value
        self.reasons.setdefault(key, []).extend(reasons)

    def format_text(self) -> str:
        """Return the text of the definition file, with the reasons as comments."""
        rows = ["{"]
        rows += [f"  // {reason}" for reason in self.reasons.get("", ())]
        for key, value in self.entries.items():
            rows += [f"  // {reason}" for reason in self.reasons.get(key, ())]
            rows.append(f"  {json.dumps(key)}: {_format_value(value)},")
        return "\n".join([*rows, "}"]) + "\n"


def _format_value(value: Any) -> str:
    """Return a value as JSON text. Lists of objects get one line per object."""
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return "[\n" + "".join(f"    {json.dumps(each, ensure_ascii=False)},\n" for each in value) + "  ]"
    return json.dumps(value, ensure_ascii=False)


def propose_definition(body: Definition, file: str) -> BodyFileProposal:
    """Return a proposal for a body that was read from `file`, a path relative to the definition file."""
    study = measure_body(body)
    proposal = BodyFileProposal()
    proposal.reasons[""] = ["Proposed by `antdsl body --propose`. Correct what is wrong, then delete the comments."]
    proposal.add_entry("antdsl_body", 1)
    proposal.add_entry("name", to_language_name(body.name))
    proposal.add_entry("from", file)
    front = _add_axes(proposal, study)
    unit = _add_unit(proposal, study)
    _add_length(proposal, study, front)
    names = _choose_clip_names(study)
    if study.idle_clip:
        proposal.add_entry("idle", names[study.idle_clip], f"`{study.idle_clip}` {_explain_idle_clip(study)}")
    else:
        proposal.reasons.setdefault("clips", []).append(
            "no clip stands still, so the rest pose is used for idle agents and for the standing height of legs"
        )
    _add_clips(proposal, study, names)
    _add_legs(proposal, study, names, front, unit)
    _add_capsule(proposal, study, front)
    return proposal


def _explain_idle_clip(study: BodyMeasurements) -> str:
    """Return the reason for the choice of the idle clip."""
    if any(word in study.idle_clip.lower() for word in IDLE_WORDS):
        return "its name suggests this"
    return f"keeps its feet on the ground for {study.planted_shares.get(study.idle_clip, 0.0):.0%} of the time, and moves least"


# ---- axes, units and length


def _add_axes(proposal: BodyFileProposal, study: BodyMeasurements) -> Floats:
    """Add `front` and `up` to the proposal, and return the front axis."""
    body, up = study.body, study.up
    word = format_axis(_round_axis(up))
    if word == format_axis(body.up):
        up_reason = (
            "up: as in the file; feet are at the lower end of this axis" if study.leg_search.feet else "up: as in the file"
        )
    else:
        up_reason = (
            f"up: with the file's {format_axis(body.up)}, no legs reach the ground; with {word}, {len(study.leg_search.legs)} "
            "legs do"
        )
    front, front_reason = _find_front(study)
    proposal.add_entry("front", format_axis(_round_axis(front)), f"front: {front_reason}")
    proposal.add_entry("up", word, up_reason)
    return front


def _find_front(study: BodyMeasurements) -> tuple[Floats, str]:
    """Return the front axis and the reason for it."""
    if study.gaits:
        gait = max(study.gaits.values(), key=lambda gait: gait.speed)
        return _find_nearest_axis(
            -gait.backward_direction, study.up
        ), f"in `{gait.clip}`, feet on the ground move in the opposite direction"
    toes = _measure_toe_direction(study)
    if toes is not None:
        return _find_nearest_axis(toes, study.up), "the feet point in this direction; no clip walks"
    default = np.array(study.body.front, np.float64)
    if abs(float(default @ study.up)) > 0.5:
        return _find_nearest_axis(
            np.cross(study.up, [0.36, 0.48, 0.8]), study.up
        ), "this is a guess: no clip walks, and the feet have no clear direction"
    return default, "as in the file; no clip walks"


def _measure_toe_direction(study: BodyMeasurements) -> Floats | None:
    """Return the mean direction from the foot joints to the points of their soles, or None if there is no clear direction."""
    total = np.zeros(3)
    for leg in study.leg_search.legs:
        below = [k for k in range(len(study.body.rig.names)) if is_below(study.body.rig, k, leg.foot)]
        points = study.points.positions[np.isin(study.points.joint_indices, below)]
        if len(points):
            total += points.mean(axis=0) - study.worlds[leg.foot, :, 3].astype(np.float64)
    total -= study.up * (total @ study.up)
    size = float(np.linalg.norm(total))
    return total / size if size > 0.02 * study.length * max(len(study.leg_search.legs), 1) else None


def _find_nearest_axis(direction: Floats, up: Floats) -> Floats:
    """Return the axis perpendicular to `up` that is nearest to a direction."""
    axes = [sign * axis for axis in np.eye(3) if abs(float(axis @ up)) < 0.5 for sign in (1.0, -1.0)]
    return max(axes, key=lambda axis: float(axis @ direction))


def _round_axis(axis: Floats) -> tuple[float, float, float]:
    x, y, z = np.round(axis).tolist()
    return x + 0.0, y + 0.0, z + 0.0


def _add_unit(proposal: BodyFileProposal, study: BodyMeasurements) -> float:
    """Add `units` to the proposal, and return the millimetres per unit."""
    body, low, high = study.body, *_PLAUSIBLE_HEIGHT_MM
    own = next((word for word, mm in UNIT_MM.items() if mm == body.unit), f"{body.unit:.15g} mm")
    height = study.leg_search.body_height
    if low <= height * body.unit <= high or height <= 0:
        proposal.add_entry("units", own, f"units: as in the file; the body is {_format_metres(height * body.unit)} high")
        return body.unit
    fitting = [word for word in _UNIT_WORDS if low <= height * UNIT_MM[word] <= high]
    word = fitting[0] if fitting else own
    unit = UNIT_MM.get(word, body.unit)
    high_words, fitting_words = _format_metres(height * body.unit), _format_metres(height * unit)
    reason = f"units: with the file's unit, {own}, the body would be {high_words} high; with this unit it is {fitting_words} high"
    proposal.add_entry("units", word, reason)
    return unit


def _format_metres(millimetres: float) -> str:
    """Return a length (mm) as text in metres."""
    return f"{millimetres / 1000:.3g} m" if millimetres >= 100 else f"{millimetres:.3g} mm"


def _add_length(proposal: BodyFileProposal, study: BodyMeasurements, front: Floats) -> None:
    """Add `length` to the proposal: the extent along the front axis, or the height of an upright body."""
    if not len(study.points.positions):
        return
    along, height = float(np.ptp(study.points.positions @ front)), study.leg_search.body_height
    if height > _MIN_UPRIGHT_RATIO * along:
        proposal.add_entry(
            "length",
            _round_digits(height),
            "length: the height, because the body stands upright; the `size` of an agent is this height",
        )
    else:
        proposal.add_entry(
            "length",
            _round_digits(along),
            "length: along the front axis in the standing pose; the `size` of an agent is this length",
        )
    if abs(study.leg_search.ground_height) > 0.05 * height:
        proposal.reasons["length"].append(
            f"the lowest point is at {_round_digits(study.leg_search.ground_height):g}, not at 0: move the model onto the ground"
        )


# ---- clips


def _choose_clip_names(study: BodyMeasurements) -> dict[str, str]:
    """Return a short name for each clip, by the clip's name in the file.

    The short name is a common word that the clip's name contains, such as `walk`. Without one, it is a word for the motion in
    the clip, or else the clip's name in the spelling of the language."""
    names: dict[str, str] = {}
    taken: set[str] = set()
    by_speed = sorted(study.gaits, key=lambda name: study.gaits[name].speed)
    nameless = [name for name in by_speed if _UNINFORMATIVE_NAME_PATTERN.fullmatch(name)]
    words = {name: word for name in by_speed if (word := _find_gait_word(name))}
    words |= {name: "walk" if k == 0 else "run" for k, name in enumerate(nameless)}
    words |= {study.idle_clip: "idle"} if study.idle_clip else {}
    order = dict.fromkeys([*words, *study.body.clips])
    for name in order:
        word, count = words.get(name) or to_language_name(re.split(r"[|/]", name)[-1] or name), 2
        unique = word
        while unique in taken:
            unique, count = f"{word}_{count}", count + 1
        taken.add(unique)
        names[name] = unique
    return names


def _find_gait_word(name: str) -> str:
    """Return the word for a gait, such as `walk`, that a clip's name contains, or "" if there is none."""
    return next((word for word in _GAIT_WORDS if word in name.lower()), "")


def _add_clips(proposal: BodyFileProposal, study: BodyMeasurements, names: Mapping[str, str]) -> None:
    """Add `clips` to the proposal: their names, strides, and whether feet are placed on the ground while they play.

    `names`: the proposed name of each clip, by its name in the file."""
    entries, reasons = [], []
    for name in study.body.clips:
        entry: dict[str, Any] = {"clip": name, "name": names[name]}
        gait = study.gaits.get(name)
        if gait is not None:
            entry["stride"] = _round_digits(gait.speed * gait.seconds)
            reasons.append(
                f"`{names[name]}`: feet on the ground move {gait.speed:.3g} units per second, in a cycle of {gait.seconds:.3g} s"
            )
        elif study.leg_search.feet and study.planted_shares[name] < MIN_STILL_SHARE:
            entry["feet"] = False
            reasons.append(
                f"`{names[name]}`: the feet leave the ground (on average, {study.planted_shares[name]:.0%} stand), so the clip "
                "moves the legs"
            )
        if gait is None and name != study.idle_clip and not study.motions[name].is_cyclic:
            entry["loop"] = False
            reasons.append(f"`{names[name]}`: the last pose of the clip does not lead to its first pose, so the clip plays once")
        entries.append(entry)
    if entries:
        proposal.add_entry("clips", entries, *reasons)
    proposal.reasons.setdefault("clips", [])
    if not study.gaits and study.body.clips:
        proposal.reasons["clips"].append("no clip walks in place, so the legs walk with the gait below")


# ---- legs and gaits


def _add_legs(
    proposal: BodyFileProposal, study: BodyMeasurements, clip_names: Mapping[str, str], front: Floats, unit: float
) -> None:
    """Add `legs` and `gaits` to the proposal. `clip_names`: the proposed name of each clip, by its name in the file."""
    search = study.leg_search
    if not search.legs:
        for reason in search.reasons or ("no chain of joints reaches the ground",):
            proposal.reasons.setdefault("clips" if study.body.clips else "front", []).append(f"no legs: {reason}")
        return
    side = np.cross(front, study.up)
    order, names = _order_legs(search.legs, study, front, side)
    rig = study.body.rig
    ordered_legs = [search.legs[k] for k in order]
    legs = [_make_leg(name, leg, rig.names) for name, leg in zip(names, ordered_legs, strict=True)]
    reasons = [f"legs: {len(legs)} chains of joints end within 5 % of the height above the lowest point", *search.reasons]
    if any(leg.ankle >= 0 for leg in ordered_legs):
        reasons.append(
            "ankle: the foot has a sole, which lies flat on the ground; without `ankle` the foot keeps its angle to the body"
        )
    proposal.add_entry("legs", legs, *reasons)
    feet = [search.feet.index(search.legs[k]) for k in order]
    gaits, gait_reasons, speeds = [], [], list[float]()
    for name, gait in sorted(study.gaits.items(), key=lambda entry: entry[1].speed):
        if any(abs(gait.speed - speed) < 0.1 * speed for speed in speeds):
            gait_reasons.append(f"`{clip_names[name]}` is as fast as another clip, so this clip defines no gait")
            continue
        speeds.append(gait.speed)
        phases = [round((gait.phases[k] - gait.phases[feet[0]]) % 1.0, 2) % 1.0 for k in feet]
        gaits.append(_make_gait(clip_names[name], gait.speed, gait.stride, gait.duty, gait.lift, phases))
        gait_reasons.append(f"`{clip_names[name]}`: from the clip `{name}`, each foot stands for {gait.duty:.0%} of a cycle")
    if not gaits:
        speed = (_WALK_FROUDE * _GRAVITY_MM * study.length * unit) ** 0.5 / unit
        leg = study.length
        gaits.append(
            _make_gait("walk", speed, _WALK_STRIDE * leg, _WALK_DUTY, _WALK_LIFT * leg, _build_usual_phases(names, len(legs)))
        )
        gait_reasons.append(f"no clip walks, so this is a typical walk for legs of {_format_metres(leg * unit)}")
    proposal.add_entry("gaits", gaits, *gait_reasons)


def _make_leg(name: str, leg: LegCandidate, joints: Sequence[str]) -> dict[str, str]:
    """Return the entry of `legs` for a leg. For a leg with an ankle, the foot joint is the joint of the toes if there is one."""
    entry = {"name": name, "upper": joints[leg.upper], "lower": joints[leg.lower]}
    return entry | ({"ankle": joints[leg.ankle], "foot": joints[leg.ball]} if leg.ankle >= 0 else {"foot": joints[leg.foot]})


def _order_legs(
    legs: Sequence[LegCandidate], study: BodyMeasurements, front: Floats, side: Floats
) -> tuple[list[int], list[str]]:
    """Return the legs as indices in the usual order, and the name of each leg. The order is from front to back, in each pair
    left before right."""
    feet = np.array([study.worlds[leg.upper, :, 3].astype(np.float64) for leg in legs])
    ahead, right = feet @ front, feet @ side
    middle = float(right.mean())
    lefts = sorted((k for k in range(len(legs)) if right[k] < middle), key=lambda k: -ahead[k])
    rights = sorted((k for k in range(len(legs)) if right[k] >= middle), key=lambda k: -ahead[k])
    pairs = max(len(lefts), len(rights))
    order, names = [], []
    for pair in range(pairs):
        for word, those in (("left", lefts), ("right", rights)):
            if pair < len(those):
                order.append(those[pair])
                names.append(word if pairs == 1 else f"{word}_{pair + 1}")
    return order, names


def _build_usual_phases(names: Iterable[str], count: int) -> list[float]:
    """Return the phases of legs in a normal walk, by the number of legs.

    Two legs alternate, four legs move one after the other, and more legs move as two tripods."""
    phases = []
    for name in names:
        pair, is_right = int(name.partition("_")[2] or 1) - 1, name.startswith("right")
        if count <= 3:
            phases.append(0.5 * is_right)
        elif count == 4:
            phases.append((0.5 * is_right + (0.0 if pair else 0.75)) % 1.0)  # hind left, fore left, hind right, fore right
        else:
            phases.append(0.5 * ((pair + is_right) % 2))
    return phases


def _make_gait(name: str, speed: float, stride: float, duty: float, lift: float, phases: list[float]) -> dict[str, Any]:
    """Return the entry of `gaits` for a gait, with rounded numbers."""
    return {
        "name": name, "speed": _round_digits(speed), "stride": _round_digits(stride), "duty": round(duty, 2),
        "lift": _round_digits(lift), "phases": phases,
    }  # fmt: skip


# ---- the capsule


def _add_capsule(proposal: BodyFileProposal, study: BodyMeasurements, front: Floats) -> None:
    """Add `capsule` to the proposal: the box of the trunk in the standing pose. Legs and outstretched arms do not count."""
    rig, search = study.body.rig, study.leg_search
    limbs = {k for leg in search.legs for k in range(len(rig.names)) if is_below(rig, k, leg.chain[0])}
    own = ~np.isin(study.points.joint_indices, sorted(limbs))
    trunk = study.points.positions[own] if own.sum() > 8 else study.points.positions
    if not len(trunk):
        return
    side = np.cross(front, study.up)
    tail = (1 - _TRUNK_LENGTH_SHARE) / 2
    pose = f"of the clip `{study.idle_clip}`" if study.idle_clip else _describe_rest_pose(study)
    if not study.idle_clip and study.gaits:
        slow = min(study.gaits.values(), key=lambda gait: gait.speed)
        worlds = study.motions[slow.clip].worlds[0]
        points = find_posed_points(study.body, worlds)
        trunk = points.positions[own] if own.sum() > 8 else points.positions
        pose = f"of the clip `{slow.clip}`, because no clip stands still, and arms may be spread in the rest pose"
    low, high = (np.quantile(trunk @ np.stack([front, study.up, side], axis=1), end, axis=0) for end in (tail, 1 - tail))
    size, middle = np.maximum(high - low, 1e-3 * search.body_height), (high + low) / 2
    proposal.add_entry(
        "capsule",
        {
            "length": _round_digits(max(size[0], size[2])), "width": _round_digits(size[2]),
            "height": _round_digits(max(middle[1], 0.0)),
            "ahead": _round_digits(middle[0]),
        },
        f"capsule: the trunk without legs, in the first pose {pose}",
    )  # fmt: skip


def _describe_rest_pose(study: BodyMeasurements) -> str:
    """Return a description of the rest pose for the text that explains the capsule."""
    return "of the file, because no clip stands or walks; check the width if the arms are spread"


def _round_digits(number: float) -> float:
    """Return the number rounded to four digits."""
    return float(f"{number:.4g}")
