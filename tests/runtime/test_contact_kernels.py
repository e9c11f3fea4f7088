"""Loops over pairs of bodies against one pair after another in float64, and closest points of segments that are searched for."""

from __future__ import annotations

from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

from antdsl.runtime.moving import correction_walks
from antdsl.runtime.moving.contacts import capsule_distances, capsules, contact_solver, separation, step_clamping
from antdsl.runtime.moving.contacts.capsule_distances import NEVER_TILTED_COSINE, TILTED_COSINE
from antdsl.runtime.moving.contacts.capsules import CapsuleCrowd, NearbyCapsulePairs, find_near_pairs, measure_overlap_depths
from antdsl.scene.library_bodies import CAPSULE_BY_BODY, COMPLETE_CAPSULE_BY_BODY
from tests.motion_track import segment_distance
from tests.runtime.test_contacts import RESTING, CrowdData, cluster, world

ROWS = 60


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=0)


def closest(away: np.ndarray, a: np.ndarray, b: np.ndarray, reach: float, length: float) -> tuple[float, float]:
    """Where s and t of away + a s - b t give the least length: in the middle, or on one of four borders."""
    inner = np.linalg.lstsq(np.stack([a, -b], axis=1), -away, rcond=1e-9)[0]
    if abs(inner[0]) <= reach and abs(inner[1]) <= length:
        return float(inner[0]), float(inner[1])
    result = []
    for s in (-reach, reach):
        result.append((s, float(np.clip((away + a * s) @ b / (b @ b), -length, length))))
    for t in (-length, length):
        result.append((float(np.clip(-(away - b * t) @ a / (a @ a), -reach, reach)), t))
    return min(result, key=lambda each: float(np.linalg.norm(away + a * each[0] - b * each[1])))


def gap_of(near: SimpleNamespace | NearbyCapsulePairs, middle: np.ndarray, p: int, q: int) -> tuple[float, np.ndarray]:
    """The gap of two capsules and the way to part, across the direction between the two ways that they stand."""
    up, other = near.up[:, p], near.up[:, q]
    between = 0 * up if up @ other < -0.5 else unit(up + other)
    a, b, away = near.axis_directions[:, p], near.axis_directions[:, q], middle[:, p] - middle[:, q]
    flat = [v - between * (v @ between) for v in (away, a, b)]
    s, t = closest(*flat, near.half_lengths[p], near.half_lengths[q])
    separation_vector = away + a * s - b * t
    over = separation_vector @ between
    separation_vector = separation_vector - between * over
    wide = near.radius[p] + near.radius[q]
    extent = wide**2 - over**2
    if np.linalg.norm(separation_vector) <= wide * 1e-6:
        separation_vector = flat[0]
        return (-np.sqrt(extent) if extent > 0 else np.inf), separation_vector / max(np.linalg.norm(separation_vector), 1e-9)
    return (np.linalg.norm(separation_vector) - np.sqrt(extent) if extent > 0 else np.inf), unit(separation_vector)


def bodies(seed: int, spread: float = 6.0, tilt: float = 0.25) -> SimpleNamespace:
    """Capsules near each other, some on two sides of a sheet, and all their pairs."""
    rng = np.random.default_rng(seed)
    up = rng.normal(0, tilt, (3, ROWS)) + np.array([[0.0], [1], [0]]) * rng.choice([1, 1, 1, -1], ROWS)
    up = unit(up)
    ahead = rng.normal(size=(3, ROWS))
    ahead = unit(ahead - up * (ahead * up).sum(axis=0))
    middle = rng.random((3, ROWS)) * [[spread], [0.6], [spread]]
    half, radius = rng.uniform(0, 1.2, ROWS), rng.uniform(0.2, 0.6, ROWS)
    ahead[:, 1], up[:, 1], middle[:, 1] = ahead[:, 0], up[:, 0], middle[:, 0] + 0.3 * np.cross(up[:, 0], ahead[:, 0])  # parallel
    i, j = (np.array(each) for each in zip(*combinations(range(ROWS), 2), strict=True))
    return SimpleNamespace(
        middle=middle, axis_directions=ahead, up=up, half_lengths=half, radius=radius, first_indices=i, second_indices=j
    )


def near_of(built: SimpleNamespace, tilted_cosine: float = NEVER_TILTED_COSINE) -> NearbyCapsulePairs:
    gap, path = np.empty(len(built.first_indices)), np.empty((3, len(built.first_indices)))
    stand = (built.middle.copy(), built.axis_directions, built.up, built.half_lengths, built.radius)
    rows, pairs = np.arange(ROWS), (built.first_indices, built.second_indices)
    near = NearbyCapsulePairs(None, rows, *pairs, *stand, 0.6, gap, path, tilted_cosine=tilted_cosine)  # type: ignore[arg-type]
    near.measure_gaps(np.zeros_like(built.middle), np.ones(ROWS, np.bool_))
    return near


@pytest.mark.parametrize("seed", range(3))
def test_tilted_capsules_overlap_where_their_axes_are_near_in_space(seed: int) -> None:
    built = bodies(seed, 4.0, 0.8)
    near = near_of(built, TILTED_COSINE)
    cosine = (built.up[:, built.first_indices] * built.up[:, built.second_indices]).sum(axis=0)
    start, along = (
        (built.middle - built.axis_directions * built.half_lengths).T,
        (2 * built.axis_directions * built.half_lengths).T,
    )
    distance = segment_distance(
        start[built.first_indices], along[built.first_indices], start[built.second_indices], along[built.second_indices]
    )
    overlap = built.radius[built.first_indices] + built.radius[built.second_indices] - distance
    tilted = (cosine < TILTED_COSINE) & (cosine > -0.5) & (np.abs(overlap) > 1e-6)
    assert np.array_equal(near.gap[tilted] < 0, overlap[tilted] > 0) and (overlap[tilted] > 0).sum() > 20
    unseen = near_of(built).gap[tilted] > 0
    assert (unseen & (overlap[tilted] > 0)).any(), "across the normal, some pairs seem clear"


@pytest.mark.parametrize("seed", range(3))
def test_gaps_of_capsules_are_those_of_their_closest_points(seed: int) -> None:
    built, rng = bodies(seed), np.random.default_rng(seed)
    near, moved = near_of(built), rng.normal(0, 0.4, (3, ROWS))
    changed = rng.random(ROWS) < 0.4
    previous = near.gap.copy(), near.direction.copy()
    expected = [gap_of(near, near.middle, p, q) for p, q in zip(near.first_indices, near.second_indices, strict=True)]
    assert np.allclose(near.gap, [gap for gap, _ in expected], atol=1e-9)
    assert np.allclose(near.direction.T, [path for _, path in expected], atol=1e-7)
    assert np.isinf(near.gap).any() and (near.gap < 0).sum() > 20
    near.measure_gaps(moved, changed)
    again = changed[near.first_indices] | changed[near.second_indices]
    expected = [gap_of(near, near.middle + moved, p, q) for p, q in zip(near.first_indices, near.second_indices, strict=True)]
    assert np.allclose(near.gap[again], np.array([gap for gap, _ in expected])[again], atol=1e-9)
    assert np.allclose(near.direction[:, again].T, np.array([path for _, path in expected])[again], atol=1e-7)
    assert np.array_equal(near.gap[~again], previous[0][~again]) and np.array_equal(
        near.direction[:, ~again], previous[1][:, ~again]
    )
    gap, path, depth = near.measure_before_step(moved)
    expected = [gap_of(near, near.middle - moved, p, q) for p, q in zip(near.first_indices, near.second_indices, strict=True)]
    assert np.allclose(gap, [each for each, _ in expected], atol=1e-9)
    assert np.allclose(path.T, [each for _, each in expected], atol=1e-7)
    assert np.allclose(depth, [max(0.0, *-gap[(near.first_indices == k) | (near.second_indices == k)]) for k in range(ROWS)])


def crowds(spread: float):
    built = world(CrowdData("ant", 90, cluster(90, spread)), CrowdData("ball", 3, cluster(3, spread), 1, body="ball"))
    rng = np.random.default_rng(7)
    for population in built.populations.values():
        for name in ("up", "heading"):
            for axis in "xyz":
                population.now[f"{name}.{axis}"] += rng.normal(0, 0.1, len(population)).astype(np.float32)
        population.now["size"][::11] *= -1
    return built


def test_capsules_lie_where_the_shape_of_a_body_puts_them() -> None:
    built = crowds(8.0)
    crowd, k = CapsuleCrowd(built), 0
    for population in built.populations.values():
        shape = capsules.find_capsule(built, population.name)
        for row in range(len(population)):
            size = max(float(population.now["size"][row]), 0.0)
            stands = [population.now[f"{name}.{axis}"][row] for name in ("up", "heading") for axis in "xyz"]
            up, heading = np.float64(stands).reshape(2, 3)
            middle = population.position[row] + up * (size * shape.height) + heading * (size * shape.forward_offset)
            assert np.allclose(crowd.middle[:, k], middle, atol=1e-12)
            assert np.isclose(crowd.radius[k], size * shape.width / 2) and np.isclose(crowd.ahead[k], size * shape.forward_offset)
            assert np.isclose(crowd.half[k], max(size * (shape.length - shape.width) / 2, 0.0))
            assert np.isclose(crowd.reach[k], crowd.half[k] + 1.6 * crowd.radius[k])
            k += 1
    assert k == len(crowd) == 93 and crowd.bounds == [(each.min(), each.max()) for each in (*crowd.middle, crowd.reach)]


@pytest.mark.parametrize("body", CAPSULE_BY_BODY)
def test_a_whole_body_does_not_reach_below_its_feet(body: str) -> None:
    crowd = CrowdData("ant", 1, cluster(1), body=body)
    old, new = (capsules.find_capsule(world(crowd, text=text), "ant") for text in (RESTING, RESTING.replace("ant 1", "ant 2", 1)))
    assert old == CAPSULE_BY_BODY[body]
    assert new.height > new.width / 2 and new.width == COMPLETE_CAPSULE_BY_BODY[body].width


@pytest.mark.parametrize("place", [np.nan, np.inf, -np.inf])
def test_one_without_a_place_has_no_neighbours(place: float) -> None:
    built = crowds(8.0)
    others = {(p, q) for p, q in pairs_of(find_near_pairs(CapsuleCrowd(built))) if 70 not in (p, q)}
    built.populations["ant"].position[70, 1] = place
    with np.errstate(invalid="ignore"):
        crowd = CapsuleCrowd(built)
        near = find_near_pairs(crowd)
    assert not np.isfinite(sum(crowd.bounds[1])) and set(pairs_of(near)) == others and len(others) > 100


def pairs_of(near: NearbyCapsulePairs) -> list[tuple[int, int]]:
    return list(zip(near.rows[near.first_indices].tolist(), near.rows[near.second_indices].tolist(), strict=True))


@pytest.mark.parametrize("dead", [None, 5e-4, 0.2, 0.6])
def test_all_pairs_that_may_meet_are_found(dead: float | None) -> None:
    built = crowds(9.0)
    built.populations["ant"].position[5] = built.populations["ant"].position[4]  # two in one place
    for axis in "xyz":
        for name in ("up", "heading"):
            built.populations["ant"].now[f"{name}.{axis}"][5] = built.populations["ant"].now[f"{name}.{axis}"][4]
        built.populations["ant"].now["size"][5] = built.populations["ant"].now["size"][4]
    crowd = CapsuleCrowd(built)
    near = find_near_pairs(crowd, dead)
    total = SimpleNamespace(half_lengths=crowd.half, radius=crowd.radius)
    total.axis_directions, total.up = (np.stack(crowd.read_vector(name)).astype(float) for name in ("heading", "up"))
    wide = crowd.radius[:, None] + crowd.radius[None]
    gaps = {(p, q): gap_of(total, crowd.middle, p, q) for p, q in combinations(range(len(crowd)), 2)}
    far = np.linalg.norm(crowd.middle[:, :, None] - crowd.middle[:, None], axis=0) > crowd.reach[:, None] + crowd.reach[None]
    far |= (crowd.reach <= 0)[:, None] | (crowd.reach <= 0)[None]
    summary = {pair: each for pair, each in gaps.items() if each[0] < 1.5 * wide[pair] and not far[pair]}
    depth = {k for pair, each in summary.items() if dead is None or each[0] < -dead * wide[pair] for k in pair}
    expected = {(p, q): each for (p, q), each in summary.items() if p in depth or q in depth}
    keys = crowd.agent_keys
    result = {tuple(sorted(pair)): k for k, pair in enumerate(pairs_of(near))}
    assert result.keys() == expected.keys() and len(result) == len(near.first_indices)
    assert all(keys[p] < keys[q] for p, q in pairs_of(near))
    for pair, k in result.items():
        sign = 1 if keys[pair[0]] < keys[pair[1]] else -1
        assert np.isclose(near.gap[k], expected[pair][0], atol=1e-9)
        if pair != (4, 5):
            assert np.allclose(near.direction[:, k], sign * expected[pair][1], atol=1e-7)
    assert np.isclose(near.max_radius, max(crowd.radius[list(pair)].max() for pair in summary))
    assert np.array_equal(near.rows, np.unique(list(expected)))
    for name, crowd_name in (("middle", "middle"), ("half_lengths", "half"), ("radius", "radius")):
        assert np.array_equal(getattr(near, name), getattr(crowd, crowd_name)[..., near.rows])
    assert np.array_equal(near.axis_directions, total.axis_directions[:, near.rows]) and np.array_equal(
        near.up, total.up[:, near.rows]
    )
    if dead is None:
        path, up = near.direction[:, result[4, 5]], near.up[:, near.first_indices[result[4, 5]]]
        assert np.isclose(np.linalg.norm(path), 1, atol=0.1) and abs(path @ up) < 0.1
        worst = [max([0.0, *(-gap for pair, (gap, _) in summary.items() if k in pair)]) for k in range(len(crowd))]
        assert np.allclose(measure_overlap_depths(built), worst / np.maximum(2 * crowd.radius, 1e-9), atol=1e-9)


# --- how far who goes -------------------------------------------------------------------------------------------------


def level(v: np.ndarray, up: np.ndarray) -> np.ndarray:
    return v - up * (v @ up)


def within(moved: np.ndarray, middle: np.ndarray, extent: float) -> np.ndarray:
    size = np.linalg.norm(middle + moved)
    return (middle + moved) * (extent / size) - middle if size > extent else moved


def shares(near, pairs, depth, light, dense_share, normal) -> dict[tuple[int, int], float]:
    """What of its overlap each of a pair makes room for, by pair and row."""
    locked = {k: sum(depth[n] for n in pairs if k in (near.first_indices[n], near.second_indices[n])) for k in range(ROWS)}
    most = max(depth.values())
    locked = {k: each / most for k, each in locked.items()}
    for _ in range(3):
        spread = dict(locked)
        for n in pairs:
            if depth[n] > 0:
                spread[near.first_indices[n]] += locked[near.second_indices[n]]
                spread[near.second_indices[n]] += locked[near.first_indices[n]]
        locked = {k: each / max(spread.values()) for k, each in spread.items()}
    result = {}
    for n in pairs:
        p, q = near.first_indices[n], near.second_indices[n]
        outward = 1 + 9 * max(dense_share[p], dense_share[q])
        outer = np.clip(0.5 + outward * (locked[q] - locked[p]) / max(locked[p] + locked[q], 1e-300), 1 / 64, 63 / 64)
        one = light[p] * outer * np.sum(level(near.direction[:, n], normal[:, p]) ** 2)
        two = light[q] * (1 - outer) * np.sum(level(near.direction[:, n], normal[:, q]) ** 2)
        part = round(one / (one + two) * 2**20) / 2**20 if one + two > 0 else 0.0
        result[n, p], result[n, q] = part, 1 - part if one + two > 0 else 0.0
    return result


def part_bodies(near: NearbyCapsulePairs, agents, which, held, walked, depth, looks, sweeps, share, cut) -> np.ndarray:
    """As `contact_solver` gives, from one pair after another."""
    size = np.linalg.norm(walked, axis=0)
    most = np.maximum(agents.max_travel, size)
    extent = np.minimum(most * 0.3 + depth, most) * agents.push_share
    dense_share = np.where(size <= 0.01 * most, 1.0, np.clip(depth / (near.radius * 0.4) - 0.5, 0, 1))
    light, moved, which = np.where(held, 0.0, 1 / agents.mass), cut.copy(), which.copy()
    dead = (near.radius[near.first_indices] + near.radius[near.second_indices]) * 5e-4
    for _ in range(looks):
        touching = np.flatnonzero(which & (near.gap < -dead))
        hit = {*near.first_indices[touching], *near.second_indices[touching]}
        pairs = [n for n in np.flatnonzero(which) if near.first_indices[n] in hit or near.second_indices[n] in hit]
        if not pairs:
            break
        overlap = {n: -near.gap[n] if near.gap[n] < -dead[n] else 0.0 for n in pairs}
        part, new_displacement = shares(near, pairs, overlap, light, dense_share, agents.normal), moved.copy()
        for _ in range(sweeps):
            sums, weight, contacts = np.zeros((3, ROWS)), np.zeros(ROWS), np.zeros(ROWS)
            for n in pairs:
                p, q = near.first_indices[n], near.second_indices[n]
                left = near.gap[n] + near.direction[:, n] @ ((new_displacement - moved)[:, p] - (new_displacement - moved)[:, q])
                if left < -dead[n]:
                    for k, path in ((p, near.direction[:, n]), (q, -near.direction[:, n])):
                        flat = level(path, agents.normal[:, k])
                        sums[:, k] -= flat * (part[n, k] / max(flat @ flat, 0.1) * left * share)
                        weight[k] += part[n, k]
                        contacts[k] += 1
            if not contacts.any():
                break
            sums *= np.where(contacts > 1, 1 + 0.5 * dense_share, 1.0) / np.maximum(weight, 1.0)
            for k in np.flatnonzero(contacts):
                new_displacement[:, k] = within(
                    within(new_displacement[:, k] + sums[:, k], -cut[:, k], extent[k]), walked[:, k], most[k]
                )
        changed = np.abs(new_displacement - moved).max(axis=0) > 0
        moved = new_displacement
        for n in np.flatnonzero(changed[near.first_indices] | changed[near.second_indices]):
            near.gap[n], near.direction[:, n] = gap_of(near, near.middle + moved, near.first_indices[n], near.second_indices[n])
            which[n] = True
    return moved


def agents_of(seed: int) -> tuple[contact_solver._ContactAgents, dict[str, np.ndarray]]:
    rng = np.random.default_rng(seed)
    normal = unit(rng.normal(0, 0.2, (3, ROWS)) + np.array([[0.0], [1], [0]]))
    mass, still = rng.choice([1.0, 1.0, 5.0], ROWS), rng.random(ROWS) < 0.2
    walked = rng.normal(0, 0.3, (3, ROWS)) * ~still
    reach = rng.uniform(0, 0.8, ROWS)
    stand = {"held": rng.random(ROWS) < 0.15, "walked": walked, "deep": rng.uniform(0, 0.4, ROWS) * (rng.random(ROWS) < 0.6)}
    stand["cut"] = rng.normal(0, 0.05, (3, ROWS)) * (rng.random(ROWS) < 0.3)
    return contact_solver._ContactAgents(0 * walked, reach, mass, rng.choice([1.0, 0.4], ROWS), normal, still), stand


@pytest.mark.parametrize("looks, sweeps, share", [(1, 1, 0.4), (1, 4, 1.0), (5, 3, 1.0)])
@pytest.mark.parametrize("seed", range(2))
def test_bodies_part_as_one_pair_after_another_says(looks: int, sweeps: int, share: float, seed: int) -> None:
    built, (agents, stand) = bodies(seed, 7.0), agents_of(seed)
    near, again = near_of(built), near_of(built)
    which = np.random.default_rng(seed).random(len(near.first_indices)) < (0.8 if looks > 1 else 1.1)
    which[near.gap == np.inf] = True
    effort, work = contact_solver.SolverIterations(looks, sweeps, 1), separation.make_buffers(ROWS, len(near.first_indices))
    for each in (near, again):
        each.measure_gaps(stand["cut"], np.ones(ROWS, np.bool_))
    inputs = (stand["held"], stand["walked"], stand["deep"])
    expected = part_bodies(again, agents, which, *inputs, looks, sweeps, share, stand["cut"])
    cached = which.copy()
    result = contact_solver._solve_separation(near, agents, which, *inputs, effort, share, stand["cut"], work)
    assert np.allclose(result, expected, atol=1e-7) and np.array_equal(which, cached)
    assert (np.abs(result - stand["cut"]).max(axis=0) > 1e-4).sum() > 20


def cut_steps(near: NearbyCapsulePairs, approach, mass, walked, gap, path) -> np.ndarray:
    """Steps that are bent along what is in their way, and cut."""
    free = {}
    for n, (p, q) in enumerate(zip(near.first_indices, near.second_indices, strict=True)):
        for own, other, paths in ((p, q, path[:, n]), (q, p, -path[:, n])):
            far = max(gap[n], 0.0) / 2 + max(-paths @ approach[:, other], 0.0)
            heavier = 1 - min(2 * mass[other] / (mass[own] + mass[other]), 1.0)
            free[n, own] = (far + heavier * max(-paths @ walked[:, own] - far, 0.0), paths)
    step = walked.copy()
    for _ in range(3):
        over: dict[int, list[np.ndarray]] = {}
        for (_, own), (far, paths) in free.items():
            if -paths @ step[:, own] > far:
                over.setdefault(own, []).append(paths * (-paths @ step[:, own] - far))
        for own, terms in over.items():
            step[:, own] += np.mean(terms, axis=0)
    part = np.ones(ROWS)
    for (_, own), (far, paths) in free.items():
        if -paths @ step[:, own] > far:
            part[own] = min(part[own], far / (-paths @ step[:, own]))
    return step * part


@pytest.mark.parametrize("seed", range(3))
def test_steps_into_others_are_bent_and_cut(seed: int) -> None:
    rng = np.random.default_rng(seed)
    near, (agents, stand) = near_of(bodies(seed, 9.0)), agents_of(seed)
    walked, approach = 3 * stand["walked"], rng.normal(0, 0.2, (3, ROWS))
    gap, path, _ = near.measure_before_step(walked)
    short, stopped, changed = step_clamping.clamp_approaching_steps(near, approach, agents.mass, walked, gap, path)
    step = cut_steps(near, approach, agents.mass, walked, gap, path)
    off = np.abs(walked + short - step).max(axis=0) > 1e-9
    assert off.sum() <= 2  # a step that is bent along something exactly is over it by rounding
    halted = (step**2).sum(axis=0) < 0.25 * (walked**2).sum(axis=0)
    was = np.isin(np.arange(ROWS), stopped)
    assert np.array_equal(was[~off], halted[~off]) and 5 < len(stopped) < ROWS
    assert np.array_equal(changed, was | (short != 0).any(axis=0)) and 5 < changed.sum() < ROWS


# --- what rounds and corrections do with it ---------------------------------------------------------------------------


def test_rounds_look_again_at_those_who_did_not_get_there() -> None:
    near, rng = near_of(bodies(3)), np.random.default_rng(3)
    requested = rng.normal(0, 0.1, (3, ROWS)) * (rng.random(ROWS) < 0.7)
    requested[:2, 5], requested[1:, 6], requested[::2, 7] = 0.0, 0.0, 0.0
    subset, expected = correction_walks.select_corrected_rows(requested)
    assert np.array_equal(subset, np.flatnonzero(requested.any(axis=0))) and np.array_equal(expected, requested[:, subset])
    got = expected * rng.choice([1.0, 0.99, 0.6, 0.4, 0.0], len(subset))
    previous, held = near.middle.copy(), rng.random(ROWS) < 0.1
    was = held.copy()
    touched = correction_walks.find_unresolved_rows(near, subset, expected, got, held)
    again = np.linalg.norm(expected - got, axis=0) > 0.05 * near.radius[subset]
    assert np.array_equal(np.flatnonzero(touched), subset[again]) and 5 < again.sum() < len(subset) - 5
    little = again & ((got * expected).sum(axis=0) < 0.5 * (expected**2).sum(axis=0))
    assert np.array_equal(held, was | np.isin(np.arange(ROWS), subset[little])) and little.sum() > 3
    previous[:, subset] += got
    assert np.array_equal(near.middle, previous)
    which = correction_walks.find_overlapping_pairs(near, touched)
    assert np.array_equal(which, touched[near.first_indices] | touched[near.second_indices])
    for k in (1, -1):  # the least overlap that counts
        near.gap[:] = (near.radius[near.first_indices] + near.radius[near.second_indices]) * -0.05 * (1 + k * 1e-9)
        assert (correction_walks.find_overlapping_pairs(near, touched) is None) == (k < 0)
    near.gap[which] = 0.0
    assert correction_walks.find_overlapping_pairs(near, touched) is None


def registers(rng: np.random.Generator, n: int) -> tuple[np.ndarray, ...]:
    return tuple(rng.normal(size=(3, n)).astype(np.float32))


def test_a_crowd_stands_and_came_as_its_registers_say() -> None:
    rng, n, rows = np.random.default_rng(4), 30, np.array([2, 3, 11, 29])
    began, place, feet = rng.normal(size=(n, 3)), rng.normal(size=(n, 3)), rng.normal(size=(n, 3)).astype(np.float32)
    speed, weight = rng.choice(np.float32([-1, 0, 7]), n), rng.choice(np.float32([0, -2, 3]), n)
    speed[rows[:3]], weight[rows[:3]] = [-1, 7, 9], [0, 3, -2]
    start, walked, normal = np.full((3, 3, 9), -7.0)
    reach, mass = np.full((2, 9), -7.0)
    species = correction_walks.SpeciesStances(began, place, feet, speed, weight)
    correction_walks.write_stances(rows, 4, species, 0.25, start, walked, normal, reach, mass)
    to = slice(4, 8)
    assert np.array_equal(start[:, to], began[rows].T) and np.array_equal(walked[:, to], (place - began)[rows].T)
    assert np.array_equal(normal[:, to], feet[rows].T) and np.array_equal(reach[to], np.maximum(speed[rows], 0) * 0.25)
    assert np.array_equal(mass[to], np.maximum(weight[rows].astype(float), 1e-30))
    assert all((each[..., 8:] == -7).all() and (each[..., :4] == -7).all() for each in (start, walked, normal, reach, mass))
    velocity, path = registers(rng, n), np.full((3, 9), -7.0)
    correction_walks.write_approach(rows, 4, velocity, np.float32(0.3), path)
    assert np.array_equal(path[:, to], (np.stack(velocity)[:, rows] * np.float32(0.3)).astype(float))
    assert (path[:, 8:] == -7).all() and (path[:, :4] == -7).all()


def test_corrections_go_no_farther_than_agents_may_walk_and_take_velocity_that_led_against_them() -> None:
    rng, n = np.random.default_rng(5), 40
    rows = np.sort(rng.permutation(n)[:25])
    began, place, to = rng.normal(size=(n, 3)), rng.normal(size=(n, 3)), rng.normal(size=(25, 3))
    speed, (far, most) = rng.choice(np.float32([0, 40]), n), np.empty((2, 25))
    assert correction_walks._has_row_out_of_range(rows, to, began, place, speed, 0.1, far, most)
    assert np.allclose(far, np.linalg.norm(to - began[rows], axis=1))
    assert np.allclose(most, np.maximum(speed[rows] * 0.1, np.linalg.norm((place - began)[rows], axis=1)))
    for part, over in ((1.0049, False), (1.0051, True)):
        end = began[rows] + (to - began[rows]) * (most / far * part)[:, None]
        assert correction_walks._has_row_out_of_range(rows, end, began, place, speed, 0.1, far.copy(), most.copy()) == over
    end[7] = np.nan
    assert correction_walks._has_row_out_of_range(rows, end, began, place, speed, 0.1, far, most)
    velocity, at, up = registers(rng, n), registers(rng, n), unit(rng.normal(size=(3, 25))).T
    to[3] = place[rows[3]]  # goes nowhere
    old, was, feet = place.copy(), np.stack(velocity).astype(float), rng.normal(size=(n, 3)).astype(np.float32)
    got = np.empty((3, 25))
    correction_walks._store_arrivals(rows, to, np.ascontiguousarray(up), np.float32(0.1), at, velocity, place, feet, got)
    assert np.array_equal(got.T, to - old[rows]) and np.array_equal(place[rows], to)
    assert np.array_equal(np.stack(at)[:, rows].T, to.astype(np.float32)) and np.array_equal(feet[rows], up.astype(np.float32))
    lost = 0
    for k, row in enumerate(rows):
        v, far = was[:, row], np.linalg.norm(got[:, k])
        if far > 0:
            against = got[:, k] / far
            back = min(max(-v @ against, 0.0), far / 0.1)
            v, lost = v + against * back, lost + (back > 0)
        assert np.allclose(np.stack(velocity)[:, row], level(v, up[k]), atol=1e-5)
    others = np.setdiff1d(np.arange(n), rows)
    assert np.array_equal(np.stack(velocity)[:, others], was[:, others])
    assert np.array_equal(place[others], old[others]) and lost > 5


def test_a_walk_is_prepared_with_the_step_the_ground_and_how_agents_stand() -> None:
    rng, n, rows = np.random.default_rng(6), 20, np.array([1, 5, 19])
    moved, feet, facing = rng.normal(size=(3, 3)), rng.normal(size=(n, 3)).astype(np.float32), registers(rng, n)
    long, (path, normal) = rng.random(n).astype(np.float32), np.empty((2, 3, 3), np.float32)
    (up, heading), size = np.empty((2, 3, 3)), np.empty(3)
    correction_walks._prepare_walk(rows, moved, feet, facing, long, path, normal, up, heading, size)
    assert np.array_equal(path, moved.astype(np.float32)) and np.array_equal(normal, feet[rows].T)
    assert np.array_equal(up, feet[rows].T.astype(float)) and np.array_equal(heading, np.stack(facing)[:, rows].astype(float))
    assert np.array_equal(size, long[rows].astype(float))


def test_who_is_stopped_faces_as_before_with_its_trunk() -> None:
    rng, n, rows, stopped, total = np.random.default_rng(8), 20, np.array([1, 5, 19]), np.array([0, 2, 3]), np.array([11, 15, 29])
    up = unit(rng.normal(size=(3, n))).astype(np.float32)
    previous, heading, shift = registers(rng, n), registers(rng, n), rng.random(30)
    for axis in range(3):
        previous[axis][5] = 2 * up[axis][5]  # straight up: it keeps its heading
    was, (ahead, middle) = np.stack(heading), rng.normal(size=(2, 3, 4))
    old = ahead.copy(), middle.copy()
    separation.restore_headings(rows, stopped, total, previous, tuple(up), heading, shift, ahead, middle)
    for row, k, all_of_them in zip(rows, stopped, total, strict=True):
        expected = unit(level(np.stack(previous)[:, row].astype(float), up[:, row])) if row != 5 else was[:, 5]
        assert np.allclose(np.stack(heading)[:, row], expected, atol=1e-5) and np.array_equal(
            ahead[:, k], np.stack(heading)[:, row]
        )
        assert np.allclose(middle[:, k], old[1][:, k] + (ahead[:, k] - old[0][:, k]) * shift[all_of_them])
    assert np.array_equal(ahead[:, 1], old[0][:, 1]) and np.array_equal(
        np.delete(np.stack(heading), rows, 1), np.delete(was, rows, 1)
    )


def test_rows_are_gathered() -> None:
    built, rows = bodies(4), np.array([3, 4, 50])
    to = capsule_distances.CapsuleArrays(*np.empty((3, 3, 3)), *np.empty((2, 3)))
    single = [tuple(np.ascontiguousarray(each, np.float32)) for each in (built.axis_directions, built.up)]
    crowd = capsule_distances.CrowdCapsules(built.middle, *single, built.half_lengths, built.radius)
    capsule_distances.gather_capsules(rows, crowd, to)
    for result, expected in zip(to[:5], (built.middle, *map(np.stack, single), built.half_lengths, built.radius), strict=True):
        assert np.array_equal(result, expected[..., rows])
