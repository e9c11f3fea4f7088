"""Assembles a proposal: a definition file with a reason for each guess, in comments above the lines that they are about."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import Definition, Rig, language_name
from antdsl.bodies.files.document_values import axis_word
from antdsl.bodies.proposing.clip_gaits import ClipGait, find_gait, planted_share
from antdsl.bodies.proposing.joint_motion import BodyPoints, ClipMotion, clip_motion, posed_points, sample_worlds
from antdsl.bodies.proposing.leg_search import FoundLeg, LegSearch, find_legs
from antdsl.scene.model import UNIT_MM

Floats = NDArray[np.float64]
_PLAUSIBLE_HEIGHT_MM = (2.0, 4000.0)  # of an animal or a person
_UNIT_WORDS = ("m", "cm", "mm")
_IDLE_WORDS = ("idle", "stand", "breath", "survey", "rest", "wait")
_GAIT_WORDS = ("walk", "run", "trot", "gallop", "jog", "sprint", "hop", "crawl", "march")
_STILL_SHARE = 0.9  # of a clip in which feet stand: with less, the clip moves them
_UPRIGHT = 1.5  # how much higher than long a body stands upright
_TRUNK_SHARE = 0.96  # of the trunk's points, which its capsule holds along each axis
_GRAVITY_MM = 9810.0
_WALK_FROUDE, _WALK_STRIDE, _WALK_DUTY, _WALK_LIFT = 0.16, 1.4, 0.62, 0.1  # of a usual walk, in leg lengths


@dataclass(slots=True, eq=False)
class Proposal:
    """A proposed definition. `lines`: keys and values in order. `reasons`: why, by key; "" for the file."""

    lines: dict[str, Any] = field(default_factory=dict)
    reasons: dict[str, list[str]] = field(default_factory=dict)

    def add(self, key: str, value: Any, *reasons: str) -> None:
        """Add a key with its reasons."""
        self.lines[key] = value
        self.reasons.setdefault(key, []).extend(reasons)

    def text(self) -> str:
        """Return the definition file. Reasons are comments."""
        rows = ["{"]
        rows += [f"  // {reason}" for reason in self.reasons.get("", ())]
        for key, value in self.lines.items():
            rows += [f"  // {reason}" for reason in self.reasons.get(key, ())]
            rows.append(f"  {json.dumps(key)}: {_value_text(value)},")
        return "\n".join([*rows, "}"]) + "\n"


def _value_text(value: Any) -> str:
    """Return JSON for a value; a list of objects has a line for each."""
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return "[\n" + "".join(f"    {json.dumps(each, ensure_ascii=False)},\n" for each in value) + "  ]"
    return json.dumps(value, ensure_ascii=False)


@dataclass(frozen=True, slots=True, eq=False)
class _Study:
    """What was measured of a body. `idle`: the clip of the standing pose, or "". `length`: of a leg."""

    body: Definition
    up: Floats
    idle: str
    worlds: NDArray[np.float32]
    points: BodyPoints
    search: LegSearch
    motions: Mapping[str, ClipMotion]
    gaits: Mapping[str, ClipGait]
    planted: Mapping[str, float]
    length: float


def propose(body: Definition, file: str) -> Proposal:
    """Return a proposal for a body that was read from `file`, a path relative to the definition file."""
    study = _study(body)
    proposal = Proposal()
    proposal.reasons[""] = ["Proposed by `antdsl body --propose`. Correct what is wrong, then delete the comments."]
    proposal.add("antdsl_body", 1)
    proposal.add("name", language_name(body.name))
    proposal.add("from", file)
    front = _add_axes(proposal, study)
    unit = _add_unit(proposal, study)
    _add_length(proposal, study, front)
    if study.idle:
        proposal.add("idle", _clip_names(study)[study.idle], f"`{study.idle}` {_idle_reason(study)}")
    else:
        proposal.reasons.setdefault("clips", []).append(
            "no clip stands still: agents that play nothing, and the standing height of legs, have the rest pose of the file"
        )
    _add_clips(proposal, study)
    _add_legs(proposal, study, front, unit)
    _add_capsule(proposal, study, front)
    return proposal


# ---- measuring


def _study(body: Definition) -> _Study:
    """Measure a body: its standing pose, legs, and the gaits of its clips."""
    idle = _named_idle(body)
    up, worlds, points, search = _stand(body, idle, np.array(body.up, np.float64))
    length = _leg_length(search, worlds)
    motions = {name: clip_motion(body, name, search.height) for name in body.clips}
    feet = search.feet
    gaits = {n: gait for n, each in motions.items() if (gait := find_gait(each, feet, up, length)) is not None}
    planted = {n: planted_share(each, feet, up, length) if feet else 0.0 for n, each in motions.items()}
    if not idle and feet:
        calm = [name for name, share in planted.items() if share > _STILL_SHARE and motions[name].seconds > 0.2]
        if calm:
            idle = min(calm, key=lambda name: _restlessness(motions[name]))
            up, worlds, points, search = _stand(body, idle, up)
            length = _leg_length(search, worlds)
    return _Study(body, up, idle, worlds, points, search, motions, gaits, planted, length)


def _stand(body: Definition, idle: str, up: Floats) -> tuple[Floats, NDArray[np.float32], BodyPoints, LegSearch]:
    """Return the up axis, joints, points and legs in the standing pose. Another axis counts if only it has legs."""
    worlds = sample_worlds(body, idle, np.zeros(1))[0]
    points = posed_points(body, worlds)
    others = [sign * axis for axis in np.eye(3)[[1, 2, 0]] for sign in (1.0, -1.0)]
    best = find_legs(body.rig, points, worlds, up)
    for other in others if len(best.legs) < 2 else ():
        search = find_legs(body.rig, points, worlds, other)
        if len(search.legs) >= 2 and len(search.legs) > len(best.legs):
            up, best = other, search
    return up, worlds, points, best


def _named_idle(body: Definition) -> str:
    """Return the first clip with a name that says that it stands, or ""."""
    for word in _IDLE_WORDS:
        for name, clip in body.clips.items():
            if word in name.lower() and clip.duration > 0:
                return name
    return ""


def _restlessness(motion: ClipMotion) -> float:
    """Return how much joints move in a clip, in units of length per second."""
    place = motion.worlds[:, :, :, 3].astype(np.float64)
    return float(np.linalg.norm(np.diff(place, axis=0), axis=2).mean()) / max(motion.step, 1e-9) if len(place) > 1 else 0.0


def _leg_length(search: LegSearch, worlds: NDArray[np.float32]) -> float:
    """Return the mean length of legs; half of the height without legs."""
    place = worlds[:, :, 3].astype(np.float64)
    lengths = [_distance(place, leg.upper, leg.lower) + _distance(place, leg.lower, leg.foot) for leg in search.legs]
    return float(np.mean(lengths)) if lengths else max(0.5 * search.height, 1e-9)


def _distance(place: Floats, a: int, b: int) -> float:
    return float(np.linalg.norm(place[b] - place[a]))


def _idle_reason(study: _Study) -> str:
    """Return why a clip is the one of agents that stand."""
    if any(word in study.idle.lower() for word in _IDLE_WORDS):
        return "says so by its name"
    return f"has feet on the ground for {study.planted.get(study.idle, 0.0):.0%} of its time and moves least"


# ---- axes, units and length


def _add_axes(proposal: Proposal, study: _Study) -> Floats:
    """Add `front` and `up`, and return the front."""
    body, up = study.body, study.up
    word = axis_word(_triple(up))
    if word == axis_word(body.up):
        up_reason = "up: that of the file; feet are at its lower end" if study.search.feet else "up: that of the file"
    else:
        up_reason = (
            f"up: along the file's {axis_word(body.up)} no legs reach the ground, along {word} {len(study.search.legs)} do"
        )
    front, front_reason = _front(study)
    proposal.add("front", axis_word(_triple(front)), f"front: {front_reason}")
    proposal.add("up", word, up_reason)
    return front


def _front(study: _Study) -> tuple[Floats, str]:
    """Return the front axis and the reason for it."""
    if study.gaits:
        gait = max(study.gaits.values(), key=lambda each: each.speed)
        return _nearest_axis(-gait.back, study.up), f"in `{gait.clip}`, feet on the ground move the other way"
    toes = _toe_direction(study)
    if toes is not None:
        return _nearest_axis(toes, study.up), "feet point this way; no clip walks"
    default = np.array(study.body.front, np.float64)
    if abs(float(default @ study.up)) > 0.5:
        return _nearest_axis(
            np.cross(study.up, [0.36, 0.48, 0.8]), study.up
        ), "no clip walks and no foot points anywhere: a guess"
    return default, "that of the file; no clip walks"


def _toe_direction(study: _Study) -> Floats | None:
    """Return the mean direction from foot joints to the points of their soles; None if feet point nowhere."""
    total = np.zeros(3)
    for leg in study.search.legs:
        below = [k for k in range(len(study.body.rig.names)) if _is_below(study.body.rig, k, leg.foot)]
        points = study.points.place[np.isin(study.points.joint, below)]
        if len(points):
            total += points.mean(axis=0) - study.worlds[leg.foot, :, 3].astype(np.float64)
    total -= study.up * (total @ study.up)
    size = float(np.linalg.norm(total))
    return total / size if size > 0.02 * study.length * max(len(study.search.legs), 1) else None


def _is_below(rig: Rig, joint: int, top: int) -> bool:
    """Return whether a joint is `top` or below it."""
    while joint >= 0 and joint != top:
        joint = int(rig.parents[joint])
    return joint == top


def _nearest_axis(direction: Floats, up: Floats) -> Floats:
    """Return the axis perpendicular to `up` that is nearest to a direction."""
    axes = [sign * axis for axis in np.eye(3) if abs(float(axis @ up)) < 0.5 for sign in (1.0, -1.0)]
    return max(axes, key=lambda axis: float(axis @ direction))


def _triple(axis: Floats) -> tuple[float, float, float]:
    x, y, z = np.round(axis).tolist()
    return x + 0.0, y + 0.0, z + 0.0


def _add_unit(proposal: Proposal, study: _Study) -> float:
    """Add `units`, and return them in millimetres."""
    body, low, high = study.body, *_PLAUSIBLE_HEIGHT_MM
    own = next((word for word, mm in UNIT_MM.items() if mm == body.unit), f"{body.unit:.15g} mm")
    height = study.search.height
    if low <= height * body.unit <= high or height <= 0:
        proposal.add("units", own, f"units: those of the file; the body is {_metres(height * body.unit)} high")
        return body.unit
    fitting = [word for word in _UNIT_WORDS if low <= height * UNIT_MM[word] <= high]
    word = fitting[0] if fitting else own
    reason = f"units: in the file's {own} the body would be {_metres(height * body.unit)} high; so it is {_metres(height * UNIT_MM.get(word, body.unit))}"
    proposal.add("units", word, reason)
    return UNIT_MM.get(word, body.unit)


def _metres(millimetres: float) -> str:
    """Return a length in words."""
    return f"{millimetres / 1000:.3g} m" if millimetres >= 100 else f"{millimetres:.3g} mm"


def _add_length(proposal: Proposal, study: _Study, front: Floats) -> None:
    """Add `length`: along the front, or the height of an upright body."""
    if not len(study.points.place):
        return
    along, height = float(np.ptp(study.points.place @ front)), study.search.height
    if height > _UPRIGHT * along:
        proposal.add("length", _rounded(height), "length: its height, since it stands upright: `size` of an agent is its height")
    else:
        proposal.add("length", _rounded(along), "length: along its front in the standing pose; `size` of an agent is this length")
    if abs(study.search.ground) > 0.05 * height:
        proposal.reasons["length"].append(
            f"the lowest point is at {_rounded(study.search.ground):g}, not at 0: move the model onto its ground, or it will hover or sink"
        )


# ---- clips


def _clip_names(study: _Study) -> dict[str, str]:
    """Return a short name for each clip: a usual word in its name, else by what it does, else its name in the language's letters."""
    names: dict[str, str] = {}
    taken: set[str] = set()
    by_speed = sorted(study.gaits, key=lambda name: study.gaits[name].speed)
    for name in [*by_speed, *(each for each in study.body.clips if each not in study.gaits)]:
        word = next((word for word in _GAIT_WORDS if word in name.lower()), "")
        if name in study.gaits:
            word = word or ("walk" if name == by_speed[0] else "run")
        elif name == study.idle:
            word = "idle"
        else:
            word = language_name(re.split(r"[|/]", name)[-1] or name)
        unique, count = word, 2
        while unique in taken:
            unique, count = f"{word}_{count}", count + 1
        taken.add(unique)
        names[name] = unique
    return names


def _add_clips(proposal: Proposal, study: _Study) -> None:
    """Add `clips`: names, strides, and whether feet are placed on the ground while they play."""
    names, entries, reasons = _clip_names(study), [], []
    for name in study.body.clips:
        entry: dict[str, Any] = {"clip": name, "name": names[name]}
        gait = study.gaits.get(name)
        if gait is not None:
            entry["stride"] = _rounded(gait.speed * gait.seconds)
            reasons.append(
                f"`{names[name]}`: feet on the ground move {gait.speed:.3g} units a second, for {gait.seconds:.3g} s a cycle"
            )
        elif study.search.feet and study.planted[name] < _STILL_SHARE:
            entry["feet"] = False
            reasons.append(f"`{names[name]}`: feet leave the ground ({study.planted[name]:.0%} stand), so it moves legs itself")
        if gait is None and name != study.idle and not study.motions[name].closes:
            entry["loop"] = False
            reasons.append(f"`{names[name]}`: its last pose is not its first, so it plays once")
        entries.append(entry)
    if entries:
        proposal.add("clips", entries, *reasons)
    proposal.reasons.setdefault("clips", [])
    if not study.gaits and study.body.clips:
        proposal.reasons["clips"].append("no clip walks in place: legs walk by the gait below")


# ---- legs and gaits


def _add_legs(proposal: Proposal, study: _Study, front: Floats, unit: float) -> None:
    """Add `legs` and `gaits`."""
    search = study.search
    if not search.legs:
        for reason in search.reasons or ("no chain of joints reaches the ground",):
            proposal.reasons.setdefault("clips" if study.body.clips else "front", []).append(f"no legs: {reason}")
        return
    side = np.cross(front, study.up)
    order, names = _ordered(search.legs, study, front, side)
    rig = study.body.rig
    legs = [
        {"name": name, "upper": rig.names[leg.upper], "lower": rig.names[leg.lower], "foot": rig.names[leg.foot]}
        for name, leg in zip(names, (search.legs[k] for k in order), strict=True)
    ]
    reasons = [f"legs: {len(legs)} chains of joints end within 5 % of the height above the lowest point", *search.reasons]
    proposal.add("legs", legs, *reasons)
    feet = [search.feet.index(search.legs[k]) for k in order]
    clip_names, gaits, gait_reasons, speeds = _clip_names(study), [], [], list[float]()
    for name, gait in sorted(study.gaits.items(), key=lambda each: each[1].speed):
        if any(abs(gait.speed - speed) < 0.1 * speed for speed in speeds):
            gait_reasons.append(f"`{clip_names[name]}` is as fast as another one, so it gives no gait")
            continue
        speeds.append(gait.speed)
        phases = [round((gait.phases[k] - gait.phases[feet[0]]) % 1.0, 2) % 1.0 for k in feet]
        gaits.append(_gait(clip_names[name], gait.speed, gait.stride, gait.duty, gait.lift, phases))
        gait_reasons.append(f"`{clip_names[name]}`: from the clip `{name}`, each foot stands {gait.duty:.0%} of a cycle")
    if not gaits:
        speed = (_WALK_FROUDE * _GRAVITY_MM * study.length * unit) ** 0.5 / unit
        leg = study.length
        gaits.append(_gait("walk", speed, _WALK_STRIDE * leg, _WALK_DUTY, _WALK_LIFT * leg, _usual_phases(names, len(legs))))
        gait_reasons.append(f"no clip walks: a usual walk for legs of {_metres(leg * unit)}")
    proposal.add("gaits", gaits, *gait_reasons)


def _ordered(legs: Sequence[FoundLeg], study: _Study, front: Floats, side: Floats) -> tuple[list[int], list[str]]:
    """Return the order of legs, pairs from front to back and left before right, and their names."""
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


def _usual_phases(names: Iterable[str], count: int) -> list[float]:
    """Return the phases of a usual walk: two legs alternate, four go one after the other, more go as two tripods."""
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


def _gait(name: str, speed: float, stride: float, duty: float, lift: float, phases: list[float]) -> dict[str, Any]:
    return {
        "name": name, "speed": _rounded(speed), "stride": _rounded(stride), "duty": round(duty, 2), "lift": _rounded(lift),
        "phases": phases,
    }  # fmt: skip


# ---- the capsule


def _add_capsule(proposal: Proposal, study: _Study, front: Floats) -> None:
    """Add `capsule`: the trunk, without legs and outstretched arms, in the standing pose."""
    rig, search = study.body.rig, study.search
    limbs = {k for leg in search.legs for k in range(len(rig.names)) if _is_below(rig, k, leg.chain[0])}
    own = ~np.isin(study.points.joint, sorted(limbs))
    trunk = study.points.place[own] if own.sum() > 8 else study.points.place
    if not len(trunk):
        return
    side = np.cross(front, study.up)
    tail = (1 - _TRUNK_SHARE) / 2
    pose = f"of the clip `{study.idle}`" if study.idle else _rest_words(study)
    if not study.idle and study.gaits:
        slow = min(study.gaits.values(), key=lambda gait: gait.speed)
        worlds = study.motions[slow.clip].worlds[0]
        points = posed_points(study.body, worlds)
        trunk = points.place[own] if own.sum() > 8 else points.place
        pose = f"of the clip `{slow.clip}`: no clip stands still, and arms may be spread in the rest pose"
    low, high = (np.quantile(trunk @ np.stack([front, study.up, side], axis=1), end, axis=0) for end in (tail, 1 - tail))
    size, middle = np.maximum(high - low, 1e-3 * search.height), (high + low) / 2
    proposal.add(
        "capsule",
        {
            "length": _rounded(max(size[0], size[2])), "width": _rounded(size[2]), "height": _rounded(max(middle[1] - search.ground, 0.0)),
            "ahead": _rounded(middle[0]),
        },
        f"capsule: the trunk without legs, in the first pose {pose}",
    )  # fmt: skip


def _rest_words(study: _Study) -> str:
    return "of the file: no clip stands or walks, so check the width if arms are spread"


def _rounded(number: float) -> float:
    """Return a number with four digits."""
    return float(f"{number:.4g}")
