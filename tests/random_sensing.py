"""Random programs of agents that sense, move, breed, die, take, give and lay scent, for the backends to agree on."""

from __future__ import annotations

import random

WORLD = """ant 1
world {
  surface ground
  obstacle stones
  curve way_in
  items food { load = 3; ripe = 1 }
  items nest { load = 0 }
}
field trail on ground { cell 8 mm; half_life 1 s; diffuse 20 mm^2/s }
field alarm_mark on ground { cell 8 mm; evaporate 50 %/s; combine max; limit 4 }
"""

NUMBERS = (
    "load",
    "fear",
    "luck",
    "id",
    "age / 1 s",
    "frame",
    "time_in_state / 1 s",
    "speed / 10 mm/s",
    "size / 4 mm",
    "trail",
    "alarm_mark",
    "max(trail, nearest: 9)",
    "length(gradient(trail)) * 1 mm",
    "smell(trail, ahead: 6 mm, turn: fear * 20 deg)",
    "around_me",
    "uniform(-1, 1)",
    "normal(0, 1)",
    "pick(0, 1, 3)",
    "distance(nearest(food)) / 50 mm",
    "distance(nearest(food, with: load > 0, within: 60 mm)) / 50 mm",
    "meal.load",
    "pal.fear",
    "pal.speed / 10 mm/s",
    "pal.age / 1 s",
    "bonds[pal]",
    "sum(n in neighbours(40 mm): bonds[n] * n.luck)",
    "falloff(meal, floor: size)",
    "falloff(pal, floor: 5 mm)",
    "distance(way_in) / 40 mm",
    "distance(stones) / 40 mm",
    "count(neighbours(25 mm))",
    "count(neighbours(25 mm, 120 deg))",
    "sum(n in neighbours(30 mm): n.fear)",
    "mean(n in neighbours(30 mm): n.load + fear)",
    "max(0, max(n in neighbours(40 mm): n.luck))",
    "sum(n in other: n.mood)",
    "sum(n in neighbours(60 mm, most: 2): n.luck)",
    "sum(f in all(food, with: load > 0, most: 1): f.load)",
    "count(n in neighbours(60 mm, of: other): distance(n) > size)",
    "best(n in neighbours(40 mm): n.luck - distance(n) / 90 mm).luck",
    "sum(f in all(food, within: 80 mm): f.load * f.ripe)",
    "sum(n in neighbours(30 mm): n.pal.luck)",
    "count(h in feelers(stones, count: 3, spread: 40 deg, reach: 30 mm): h.distance < 20 mm)",
    "ray(heading, reach: 40 mm, on: stones).distance / 40 mm",
    "length(sum(n in neighbours(30 mm): direction(n, to: self)))",
    "dot(heading, tangent(way_in))",
    "count(n in a: n.fear > fear)",
    "min(9, min(n in neighbours(50 mm): angle(heading, n.heading) / 1 rad))",
    "slope / 1 deg",
    "length(uphill)",
)
PUSHES = (
    "heading * 0.4",
    "seek(meal)",
    "arrive(nearest(nest))",
    "flee(pal)",
    "wander()",
    "separate(15 mm)",
    "cohere(40 mm)",
    "align(30 mm)",
    "climb(trail)",
    "follow(way_in, within: 40 mm)",
    "avoid(stones)",
    "pursue(pal)",
    "direction(pal) * 0.6",
    "halt()",
    "vector(luck, 0, fear)",
    "limit(mean(n in neighbours(40 mm, of: other): direction(n)), 0.7)",
    "match(rotate(heading, about: up, by: 30 deg) * 20 mm/s)",
)
CONDITIONS = (
    "meal",
    "no pal",
    "touching(nest)",
    "touching(stones)",
    "scared",
    "chance 60 %/s",
    "any(n in neighbours(20 mm): n.state == state)",
    "every(n in neighbours(20 mm): n.load > 0)",
    "ping",
    "ping and chance 500 %/s",
    "pal and pal.state == p",
    "touching(meal)",
    "touching(pal)",
    "nearest(neighbours(12 mm))",
    "other_mood.state == calm",
)
_TAKEN = (" take 0.3 load from trail", " take all load from alarm_mark", " take all load from meal", " take all from trail")
BONDS = (
    "bonds[pal] += {v}{rate}",
    "bonds[nearest(a)] = {v}",
    "bonds[n in neighbours(40 mm)] -= (n.luck - 0.4){rate}",
    "bonds[n in all(a, within: 50 mm, most: 3)] = bonds[n] * 0.5 + n.fear",
)
TARGETS = ("p", "q", "r", "previous", "choose { p: 1; q: luck + 1; r: count(neighbours(20 mm)) }")


class Sensing:
    """`text` is a program with the species `a` and `other`."""

    numbers, pushes, conditions, declarations = NUMBERS, PUSHES, CONDITIONS, ""

    def __init__(self, seed: int) -> None:
        self.rng = random.Random(seed)
        self.text = self._program()

    def number(self, depth: int = 2) -> str:
        rng = self.rng
        if depth == 0 or rng.random() < 0.3:
            word = rng.choice(self.numbers)
            return f"({word})" if " " in word else word
        a, b = self.number(depth - 1), self.number(depth - 1)
        form = rng.choice(
            (
                "({a} + {b})",
                "({a} - {b})",
                "{a} * {b}",
                "min({a}, {b})",
                "(if {c} then {a} else {b})",
                "sin({a} * 1 rad)",
                "rising({a}, 0 .. 2)",
                "exp(-abs({a}))",
                "mix({a}, {b}, 0.3)",
                "ramp({a}, from: -1 .. 1, to: 0 .. 2)",
                "({a} / {b})",
                "sqrt(abs({a}))",
                "floor({a})",
            )
        )
        return form.format(a=a, b=b, c=self.condition())

    def bounded(self) -> str:
        """A number that is finite whatever happens inside: NaN loses against the bounds."""
        return f"clamp({self.number()}, -5 .. 5)"

    def condition(self) -> str:
        rng = self.rng
        first = rng.choice(self.conditions) if rng.random() < 0.6 else f"{self.number(1)} > {rng.choice((0, 0.5, 1, 2))}"
        return first if rng.random() < 0.7 else f"({first} {rng.choice(('and', 'or'))} not ({rng.choice(self.conditions)}))"

    def lines(self, body: bool) -> str:
        rng, statements = self.rng, []
        kinds = ["fear", "luck", "lay", "mark", "give", "emit", "pal", "bond"] + ([] if body else ["spawn", "die"])
        for kind in rng.sample(kinds, rng.randint(0, 3)):
            rate = " * 1 /s" if body else ""
            statements.append(
                {
                    "fear": f"fear += {self.bounded()}{rate}",
                    "luck": f"luck = {self.bounded()}",
                    "lay": f"deposit trail max(0, {self.bounded()}){rate}",
                    "mark": f"deposit alarm_mark abs({self.bounded()}){rate}",
                    "give": "give 2 /s load to nearest(nest)" if body else "give all load to nest",
                    "emit": rng.choice(
                        ("emit ping", "emit ping(within: 30 mm)", "emit ping to pal", "emit ping(within: 20 mm) to nearest(a)")
                    ),
                    "pal": rng.choice(("pal = nearest(a)", "pal = random(a)", "pal = nearest(neighbours(40 mm, 200 deg))")),
                    "bond": rng.choice(BONDS).format(v=self.bounded(), rate=rate),
                    "spawn": "spawn a",
                    "die": "die",
                }[kind]
            )
        return "; ".join(statements)

    def change(self) -> str:
        rng = self.rng
        what = self.condition()
        what += rng.choice(("", "", "", " held 0.2 s", " take 1 load from nearest(food)", " take 0.5 load from meal", *_TAKEN))
        if rng.random() < 0.2:
            what = f"after {rng.choice((0.1, 0.3))} s"
        actions = self.lines(body=False)
        return f"when {what} -> {rng.choice(TARGETS)}" + (f" {{ {actions} }}" if actions else "")

    def _latch(self) -> str:
        """Its thresholds do not hang on the latch itself."""
        every = self.conditions
        self.conditions = tuple(each for each in every if each != "scared")
        latch = f"latch scared = {self.number(1)} > 1.5 until {self.number(1)} < 0.5"
        self.conditions = every
        return latch

    def _program(self) -> str:
        rng = self.rng
        text = f"""use steering
species a {{
param dash = 40 mm/s
size uniform(3 mm, 5 mm)
max_speed dash * uniform(0.5, 1)
response {rng.choice(("0.15 s", "1 step", "0.4 s"))}
{rng.choice(("", "max_turn 400 deg/s"))}
load = 0
fear = 0 relax to 0.2 over 2 s
luck = uniform(0, 1)
pal = none of a
bonds = 0 relax to 0 over 1 s for each a, strongest {rng.choice((1, 2, 4))}
let meal = nearest(food, with: load > 0, within: 80 mm)
let around_me = count(neighbours({rng.choice((20, 35))} mm))
{self.declarations}{self._latch()}
on ping {{ fear += {self.bounded()} }}
on spawn {{ pal = nearest(a); luck = luck * {self.bounded()} }}
machine moving {{
start p
"""
        for _ in range(rng.randint(0, 1)):
            text += f"from any except p {self.change()}\n"
        for name, following in (("p", "q"), ("q", "r"), ("r", "p")):
            text += f"state {name}" + rng.choice(("", "", " for at least 0.2 s")) + " {\n"
            if rng.random() < 0.5:
                text += f"  steer {rng.choice(self.pushes)}\n"
            for part in ("enter", "exit"):
                lines = self.lines(body=False) if rng.random() < 0.2 else ""
                text += f"  {part} {{ {lines} }}\n" if lines else ""
            for _ in range(rng.randint(0, 2)):
                text += f"  {rng.choice(('', 'interrupt '))}{self.change()}\n"
            text += f"  when chance 80 %/s -> {following}\n"
            lines = self.lines(body=True)
            text += (f"  {lines}\n" if lines else "") + "}\n"
        text += "}\nmachine other_mood { start calm\nstate calm { when fear > 1 -> upset }\n"
        text += "state upset { when chance 50 %/s -> calm } }\n"
        layers = rng.sample(self.pushes, rng.randint(0, 3))
        layers = [f"{push} when {self.condition()}" if rng.random() < 0.3 else push for push in layers] + ["state"]
        rng.shuffle(layers)
        if rng.random() < 0.4:  # turns the body alone
            layers.insert(rng.randint(0, len(layers)), f"face {rng.choice(self.pushes)}")
        text += f"layers {rng.choice(('', 'sum ', 'first '))}{{ {'; '.join(layers)} }}\n}}\n"
        text += "species other { mood = uniform(0, 2)\nstart go\nstate go { steer wander(); when ping -> stop }\n"
        return text + "state stop { mood += 10 %/s; emit ping(within: 40 mm); when after 0.3 s -> go } }\n"
