"""A substep of one agent after another in float64, from the definitions: what the kernels of `runtime/moving` are tested against.

Rotations are those of SciPy, angles those of `math`. The ground finds walls; its rays have separate tests."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from scipy.spatial.transform import Rotation

AT_ONCE, TURN_TIME, BOUNCE = 1.0001, 0.1, 0.3


@dataclass
class Wall:
    """A wall before an agent: its normal, the direction ahead, the angle of the ground, how far, over how much; half a body."""

    normal: np.ndarray
    ahead: np.ndarray
    angle: float
    far: float
    over: float
    half: float

    def nearer(self, displacement: np.ndarray) -> float:
        return (displacement @ self.normal) / min(self.ahead @ self.normal, -1e-3)


def length(v: np.ndarray) -> float:
    return float(np.linalg.norm(v))


def unit(v: np.ndarray, otherwise: np.ndarray | None = None) -> np.ndarray:
    size = length(v)
    if otherwise is not None and not (1e-12 < size < math.inf):
        return otherwise
    return v / size


def flat(v: np.ndarray, up: np.ndarray) -> np.ndarray:
    return v - up * (v @ up)


def across(up: np.ndarray) -> np.ndarray:
    return unit(flat(np.array([0.0, 1, 0] if abs(up[0]) > 0.9 else [1.0, 0, 0]), up))


def at_least(value: float, least: float = 0.0) -> float:
    return value if math.isnan(value) or value > least else least


def turned(v: np.ndarray, axis: np.ndarray, angle: float) -> np.ndarray:
    return Rotation.from_rotvec(axis * angle).apply(v)


def angle_between(one: np.ndarray, other: np.ndarray) -> float:
    return math.atan2(length(np.cross(one, other)), one @ other)


def axis_of(one: np.ndarray, other: np.ndarray, ahead: np.ndarray) -> np.ndarray:
    """The axis of the least turn; near half a turn that over `ahead`."""
    axis = np.cross(one, other)
    if length(axis) > 0.05 or one @ other > 0:
        return axis / max(length(axis), 1e-300)
    return unit(np.cross(one, ahead))


def laid(heading: np.ndarray, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return level(turned(heading, axis_of(one, other, heading), angle_between(one, other)), other)


def level(v: np.ndarray, up: np.ndarray) -> np.ndarray:
    along = flat(v, up)
    return unit(along) if length(along) > 1e-6 else across(up)


class Agent(SimpleNamespace):
    """An agent's registers as float64: vectors as arrays, numbers as floats, and its ground's `normal`, `place` and `state`."""

    @classmethod
    def of(cls, crowd, i: int) -> Agent:
        numbers = {name: float(values[i]) for name, values in crowd.now.items() if "." not in name}
        names = {name.partition(".")[0] for name in crowd.now if "." in name}
        vectors = {name: np.array([crowd.now[f"{name}.{axis}"][i] for axis in "xyz"], float) for name in names}
        agent = cls(**numbers, **vectors, normal=crowd.normal[i].astype(float), place=crowd.position[i].copy())
        agent.leans = any(crowd.now[f"up.{axis}"][i] != crowd.normal[i, k] for k, axis in enumerate("xyz"))
        agent.wish = getattr(agent, "~face", None)
        agent.looking = laid(agent.heading, agent.up, agent.normal) if agent.leans else agent.heading
        agent.half = agent.size / 2 if 0 < agent.size < math.inf else 0.0
        agent.wall = None
        return agent

    def push_on(self, total: float, dt: float, first: bool) -> None:
        """Set `velocity` after the push, `step` and `tilts`, the most that the body tilts."""
        up, self.at_once = self.normal, self.response <= total * AT_ONCE
        time = (total if first else 0.0) if self.at_once else dt
        previous, wish = flat(self.velocity, up), flat(self.push, up)
        wish = wish / max(length(wish), 1.0)
        gain = self.max_force / self.mass if self.mass else math.inf
        v = previous + wish * ((gain if math.isfinite(gain) else 0.0) * time)
        fastest = at_least(self.max_speed)
        if length(v) > fastest:
            v = v * (fastest / length(v))
        v = np.where(np.isfinite(v), v, 0.0)
        if hasattr(self, "min_speed"):
            v = self.hasten(v, previous, float(np.minimum(at_least(self.min_speed), fastest)))
        if math.isfinite(self.max_turn):
            v = self.turn_at_most(v, previous, at_least(self.max_turn) * time)
        self.velocity, self.step = v * (not self.alone), v * dt * (not self.alone)
        walking = at_least(self.max_speed) / (self.size if self.size > 0 else 1.0) * math.pi / 2
        rate = float(np.maximum(np.minimum(at_least(self.max_turn), walking), math.pi / 4))
        self.tilts = rate * dt if math.isfinite(rate) else math.pi

    def hasten(self, v: np.ndarray, previous: np.ndarray, least: float) -> np.ndarray:
        if not length(v) < least or math.isnan(self.max_speed):
            return v
        ahead = unit(previous, unit(flat(self.heading, self.normal), 0 * v))
        along = v @ ahead
        return v + ahead * (math.sqrt(max(least**2 - v @ v + along**2, 0.0)) - along)

    def turn_at_most(self, v: np.ndarray, previous: np.ndarray, most: float) -> np.ndarray:
        if length(previous) == 0:
            most = 4.0
        ahead = unit(previous, unit(v, across(self.normal)))
        direction = unit(v, ahead)
        if not angle_between(ahead, direction) > most:
            return v
        side = unit(flat(direction, ahead), np.cross(self.normal, ahead))
        turned = ahead * math.cos(most) + side * math.sin(most)
        creep = length(v) if self.at_once else 0.1 * self.max_speed
        return turned * at_least(v @ turned, float(np.minimum(length(v), creep)))

    def looks(self) -> list[np.ndarray]:
        """The directions in which it looks for walls."""
        along = flat(self.step, self.normal)
        self.long = length(along)
        path = along / self.long if self.long > 1e-9 else self.looking
        same = path @ self.looking
        backward = self.wish is not None and same < 0 and self.wish.any()
        return [self.looking, path] if same < 0.97 and not backward else [self.looking]

    def meet(self, ahead: np.ndarray, part: float, normal: np.ndarray) -> None:
        """Note a wall that a look has met, if the body tilts further for it."""
        normal = -normal if normal @ ahead > 0 else normal
        angle, sine = angle_between(self.normal, normal), length(np.cross(self.normal, normal))
        sine = max(sine, 1e-6)
        over = self.half * min(max(angle / sine, 2.0), 3.0)
        far = max(part * 3 * self.half - 0.06 * self.half * (self.normal @ normal) / sine, 0.0)
        if self.normal @ normal >= math.sqrt(0.5) or far >= over + 2 * self.long:
            return
        if self.wall is None or (1 - far / over) * angle > (1 - self.wall.far / self.wall.over) * self.wall.angle:
            self.wall = Wall(normal, ahead, angle, far, over, self.half)

    def tilted(self, normal: np.ndarray, displacement: np.ndarray) -> np.ndarray:
        """How the body should stand on ground of a normal when the feet have gone so far."""
        if self.wall is None:
            return normal
        w, axis = self.wall, np.cross(normal, self.wall.normal)
        part = min(max(1 - (w.far - w.nearer(displacement)) / w.over, 0.0), 1.0) * w.angle
        part = min(part, angle_between(normal, w.normal))
        return turned(normal, axis / length(axis), part) if part > 0 and length(axis) > 1e-6 else normal

    def wait(self) -> None:
        """Shorten the step and slow down such that the body can follow."""
        self.was_leaning = self.leans or self.wall is not None
        if not self.was_leaning:
            return
        size, free = length(self.step), math.inf
        if self.wall is not None:
            w = self.wall
            towards = w.nearer(self.step / max(size, 1e-300))
            tilt = w.angle - angle_between(self.up, w.normal) + self.tilts
            if towards > 0.05:
                free = max(w.over * (tilt / w.angle - 1) + w.far, 0.0) / towards
        lag = min(1.0, 2 * max(self.up @ self.tilted(self.normal, np.zeros(3)), 0.0))
        part = min(lag, min(free / max(size, 1e-300), 1.0))
        self.step, self.velocity = self.step * part, self.velocity * max(part, 0.05)

    def arrive(self, place, up, ahead, direction, blocked: bool, dt: float) -> None:
        """Velocity and heading where the walk has led; whether the body has to follow later."""
        v = direction * length(self.velocity)
        if blocked:
            actual_velocity = (place - self.place) / dt
            v = actual_velocity - (self.step / dt - actual_velocity) * BOUNCE
        v = flat(v, up)
        free = 0.0 if self.was_leaning else self.tilts
        tilt = min(2 * math.asin(min(length(up - self.up) / 2, 1.0)), free)
        hasty = 2 * math.asin(min(length(up - self.up) / 2, 1.0)) > free
        heading = self.face(ahead, v, up, tilt, dt)
        turn = angle_of(frame(heading, up) @ frame(self.heading, self.up).T)
        hasty = hasty or turn > at_least(self.max_turn) * dt * 1.005 + 1e-6
        self.follows, self.gone = hasty or self.was_leaning, place - self.place
        self.before = (self.up, self.heading)
        self.velocity, self.heading, self.up, self.place = v, heading, up, place

    def face(self, ahead: np.ndarray, v: np.ndarray, up: np.ndarray, tilt: float, dt: float) -> np.ndarray:
        heading = unit(flat(ahead, up), across(up))
        direction, faces = unit(v, heading), False
        if self.wish is not None:
            along = flat(unit(self.wish, up), up)
            faces = length(along) > 1e-3
            direction = unit(along, direction) if faces else direction
        limited = math.isfinite(self.max_turn)
        if heading @ direction < 0 and not (self.at_once and not limited):
            left = np.cross(up, heading)
            direction = unit(flat(unit(flat(direction, heading), left), up), left)
        eager = 1.0 if faces else float(np.minimum(length(v) / max(at_least(self.max_speed) * 0.1, 1e-6), 1.0))
        change = (direction - heading) * (1.0 if self.at_once else (1 - math.exp(-dt / TURN_TIME)) * eager)
        if limited:
            most = math.sqrt(max((at_least(self.max_turn) * dt) ** 2 - tilt**2, 0.0))
            change = change * (most / length(change)) if length(change) > most else change
        return unit(flat(heading + change, up), heading)

    def follow(self, dt: float) -> None:
        """Turn the body after its feet."""
        if not self.follows:
            return
        (stands, look), normal = self.before, self.up
        look, expected = level(look, stands), self.tilted(normal, self.gone)
        axis, tilt = axis_of(stands, expected, look), min(angle_between(stands, expected), self.tilts)
        up = expected if tilt < self.tilts else turned(stands, axis, tilt)
        one = level(turned(look, axis, tilt), up)
        other = laid(laid(self.heading, normal, expected), expected, up)
        most = 4.0
        if math.isfinite(self.max_turn):
            most = math.sqrt(max((at_least(self.max_turn) * dt) ** 2 - tilt**2, 0.0))
        yaw = math.atan2(np.cross(up, one) @ other, one @ other)
        facing = other if abs(yaw) <= most else turned(one, up, math.copysign(most, yaw))
        if self.wall is not None and self.head(up, facing) < min(self.head(up, one), 0.0):
            facing = one
        self.up, self.heading = up, facing

    def head(self, up: np.ndarray, facing: np.ndarray) -> float:
        """How far (mm) the head is before the wall."""
        w = self.wall
        return (up * 0.2 * w.half + w.ahead * (w.nearer(self.gone) - w.far) + facing * w.half) @ w.normal


def frame(heading: np.ndarray, up: np.ndarray) -> np.ndarray:
    return np.stack([heading, up, np.cross(up, heading)], axis=1)


def angle_of(turn: np.ndarray) -> float:
    return 2 * math.asin(min(math.sqrt(max(3 - np.trace(turn), 0.0)) / 2, 1.0))


def find_walls(ground, crowd, agents: list[Agent]) -> None:
    """Give agents the walls before them."""
    if ground.meshes is None:
        return
    rows = ground.meshes.find_rows_near_slopes(crowd.footing, crowd.position, np.array([3 * agent.half for agent in agents]), 1)
    looks = [(agents[i], ahead) for i in rows for ahead in agents[i].looks()]
    if looks:
        origins = np.array([agent.place + agent.normal * (0.06 * agent.half) for agent, _ in looks])
        hit, parts, normals = ground.meshes.find_hit_normals(
            origins, np.array([ahead * (3 * agent.half) for agent, ahead in looks]), 1
        )
        for k, part, normal in zip(hit, parts, normals.T, strict=True):
            looks[k][0].meet(looks[k][1], part, normal)


def substep(ground, crowd, total: float, dt: float, first: bool) -> list[Agent]:
    """All agents of a crowd after a substep without obstacles."""
    agents = [Agent.of(crowd, i) for i in range(len(crowd))]
    for agent, alone in zip(agents, crowd.quarantined, strict=True):
        agent.alone = alone
        agent.push_on(total, dt, first)
    find_walls(ground, crowd, agents)
    for agent in agents:
        agent.wait()
    step, looking = (np.array([getattr(agent, name) for agent in agents]) for name in ("step", "looking"))
    moved = ground.move(crowd.footing, step, looking, crowd.normal.astype(float), crowd.now["size"].astype(float))
    for i, agent in enumerate(agents):
        agent.arrive(moved.position[i], moved.up[i], moved.heading[i], moved.direction[i], bool(moved.is_blocked[i]), dt)
        agent.follow(dt)
    return agents
