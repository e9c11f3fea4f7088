"""A scene that Python simulates step by step. It gives access to agents at the current frame and to params, and calls functions
after each step."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from operator import index
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, SupportsIndex, TypeVar

from antdsl.api.crowds import Crowd, Field, ItemGroup, make_unknown_name_error
from antdsl.api.errors import AntdslError
from antdsl.diagnostics import Report
from antdsl.fields.vector_field import list_program_fields

if TYPE_CHECKING:
    from os import PathLike

    from antdsl.pipeline import Shot
    from antdsl.runtime.world import World
    from antdsl.scene.values import FrameRange

Observer = TypeVar("Observer", bound="Callable[[Simulation], object]")


def open_scene(
    path: str | PathLike[str],
    *,
    seed: SupportsIndex | None = None,
    set: Mapping[str, str | float] | None = None,
    frames: tuple[SupportsIndex, SupportsIndex] | None = None,
    roots: Mapping[str, str | PathLike[str]] | None = None,
    threads: int = 1,
) -> Simulation:
    """Open a scene and return its simulation at the first frame.

    `seed`, `frames` (first, last): values that override those of the scene.
    `set`: values of params and field settings by name, such as `{"forager.smell": "20 mm"}`. A param may also be a number, in
    base units.
    `roots`: folders outside the scene's folder that the scene may read, by name.
    `threads`: the number of threads for a step; results do not depend on it.

    Raises AntdslError with the report if the scene or a program has errors. Warnings are in `Simulation.report`."""
    from antdsl.pipeline import RunChoices
    from antdsl.pipeline import open_scene as open_shot

    grants = {name: Path(folder) for name, folder in (roots or {}).items()}
    params = {name: str(value) for name, value in (set or {}).items() if isinstance(value, str)}
    choices = RunChoices(grants, read_frames(frames), None if seed is None else read_seed(seed), params)
    shot, report = open_shot(Path(path), choices)
    if shot is None or not report.ok:
        raise AntdslError.from_report(report)
    simulation = Simulation(shot, report, threads)
    for name, value in (set or {}).items():
        if not isinstance(value, str):
            simulation.set_param(name, value)
    return simulation


def read_seed(seed: SupportsIndex) -> int:
    """Return a seed as a Python integer. NumPy integers are accepted. Raises AntdslError for any other value."""
    try:
        number = index(seed)
    except TypeError:
        number = -1
    if not 0 <= number < 2**63:
        raise AntdslError(f"`{seed}` is not a seed", "write a whole number, 0 or more")
    return number


def read_frames(frames: tuple[SupportsIndex, SupportsIndex] | None) -> FrameRange | None:
    """Return the range of frames from (first, last), or None if `frames` is None. Raises AntdslError for any other value."""
    from antdsl.scene.values import FrameRange

    if frames is None:
        return None
    try:
        first, last = map(index, frames)
    except (TypeError, ValueError):
        first, last = 1, 0
    if first > last:
        raise AntdslError(f"`{frames}` is not a range of frames", "write (1, 240)")
    return FrameRange(first, last)


class Simulation:
    """A running scene. `simulation["ant"]` returns the agents of a species; `items` and `fields` are mappings by name.

    `report`: the warnings about the scene. `world`: the internal world of the run, which may change in any version."""

    def __init__(self, shot: Shot, report: Report, threads: int = 1) -> None:
        from antdsl.measures.run_measures import RunMeasures
        from antdsl.runtime import BindError, Options, bind, step

        self._shot, self.report = shot, report
        self._observers: list[Callable[[Simulation], object]] = []
        self._has_failed = False
        try:
            self.world: World = bind(shot.plan, shot.setting, Options(threads=threads))
        except BindError as error:
            raise AntdslError.from_report(error.report) from None
        for _ in range(shot.scene.model.preroll):
            self._advance(partial(step, self.world))
        self._measures = RunMeasures(shot.measures, shot.until, self.world)
        self._measures.record_frame(self.world)

    @property
    def frame(self) -> int:
        """The current frame of the scene."""
        return self.world.frame

    @property
    def first_frame(self) -> int:
        """The first frame of the scene."""
        return self._shot.frames.first

    @property
    def last_frame(self) -> int:
        """The last frame of the scene."""
        return self._shot.frames.last

    @property
    def time(self) -> float:
        """The seconds since the first frame."""
        return (self.frame - self.first_frame) * self.world.dt

    @property
    def origin(self) -> tuple[float, float, float]:
        """The point (in mm) from which positions in attributes are measured. It is (0, 0, 0) unless the world is far from the
        coordinate origin."""
        x, y, z = self.world.origin.tolist()
        return x, y, z

    @property
    def species(self) -> tuple[str, ...]:
        """The names of the species."""
        return tuple(self.world.populations)

    @property
    def items(self) -> Mapping[str, ItemGroup]:
        """The items, by name."""
        return MappingProxyType({name: ItemGroup(self, name) for name in self.world.items})

    @property
    def fields(self) -> Mapping[str, Field]:
        """The fields, by name."""
        return MappingProxyType({name: Field(self, name) for name in list_program_fields(self.world)})

    @property
    def measures(self) -> Mapping[str, float | int | None]:
        """The program's measures at this frame by name, in base units; None for a value that is not finite."""
        return MappingProxyType(dict(self._measures.values))

    @property
    def params(self) -> Mapping[str, float]:
        """The values of all params in base units, by name. `set_param` changes one."""
        return MappingProxyType({name: float(value) for name, value in self.world.params.items()})

    def set_param(self, name: str, value: str | float) -> None:
        """Set a param from the next step on. `value`: text with a unit, such as `20 mm/s`, or a number in base units.

        Raises AntdslError for an unknown param, a wrong unit, or a value outside the declared range."""
        from antdsl.runtime import set_param
        from antdsl.scene.field_settings import list_settable_names
        from antdsl.scene.overrides import read_overrides

        shot = self._shot
        param = shot.program.params.get(name)
        if param is None and name in list_settable_names(shot.program):
            raise AntdslError(f"`{name}` is a setting of a field", "write text with a unit in `open_scene(…, set={…})`")
        if param is None:
            raise make_unknown_name_error("param", name, tuple(shot.program.params))
        report = Report()
        unit = f" {param.unit}" if param.unit else ""
        text = value if isinstance(value, str) else f"{self._to_shown_unit(name, float(value))!r}{unit}"
        quantities = read_overrides(shot.scene, shot.program, {name: text}, report)
        if not report.ok:
            raise AntdslError.from_report(report)
        number = quantities[name].to_base_units(shot.scene.model.unit_mm, self.world.dt)
        set_param(self.world, name, number if isinstance(value, str) else float(value))

    def _to_shown_unit(self, name: str, value: float) -> float:
        """Convert a param's value from base units to the unit in which the program declares the param."""
        from antdsl.scene.quantities import parse_quantity

        unit = self._shot.program.params[name].unit
        one = parse_quantity(f"1 {unit}").to_base_units(self._shot.scene.model.unit_mm, self.world.dt) if unit else 1.0
        return value / one

    def step(self, count: int = 1) -> Simulation:
        """Simulate `count` frames, if necessary beyond the last frame of the scene. Return the simulation.

        Raises AntdslError if `count` is negative, a value of an agent becomes NaN or infinite, or a limit is exceeded."""
        from antdsl.runtime import step

        if count < 0:
            raise AntdslError(f"{count} frames cannot be simulated", "write 0 or more")
        for _ in range(count):
            self._advance(partial(step, self.world))
            self._measures.record_frame(self.world)
            for observer in tuple(self._observers):
                observer(self)
        return self

    def _advance(self, run: Callable[[], object]) -> None:
        from antdsl.runtime import FaultStop

        if self._has_failed:
            raise AntdslError("an earlier step failed, so the simulation cannot continue", "open the scene again")
        try:
            run()
        except FaultStop as error:
            self._has_failed = True
            raise AntdslError(str(error)) from None
        except BaseException:
            self._has_failed = True
            raise

    def run(self, until: Callable[[Simulation], bool] | None = None) -> Simulation:
        """Simulate to the end of the scene, and return the simulation. Stop earlier if the scene's `until` condition holds, or
        if the function `until` returns True."""
        while self.frame < self.last_frame and not self._measures.is_over:
            self.step()
            if until is not None and until(self):
                break
        return self

    def observe(self, observer: Observer) -> Observer:
        """Register a function that is called with the simulation after each step. Return it, so that `observe` can be used as a
        decorator."""
        self._observers.append(observer)
        return observer

    def stop_observing(self, observer: Callable[[Simulation], object]) -> None:
        """Stop calling an observer after each step. Raises AntdslError if the function is not registered."""
        if observer not in self._observers:
            raise AntdslError("this function is not an observer of the simulation", "pass the function that `observe` got")
        self._observers.remove(observer)

    @property
    def state_hash(self) -> str:
        """The state hash, as `antdsl run` writes it for each frame. Equal hashes mean equal states."""
        from antdsl.runtime import state_hash

        return state_hash(self.world)

    def __getitem__(self, species: str) -> Crowd:
        """Return the agents of a species. Raises AntdslError if the program has no such species."""
        if species not in self.world.populations:
            raise make_unknown_name_error("species", species, self.species)
        return Crowd(self, species)

    def __iter__(self) -> Iterator[str]:
        return iter(self.species)

    def __contains__(self, species: object) -> bool:
        return species in self.world.populations

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.species)

    def __repr__(self) -> str:
        crowds = ", ".join(f"{len(population):,} {name}" for name, population in self.world.populations.items())
        return f"<simulation of {Path(self._shot.scene.source.path).name!r}, frame {self.frame} of {self.last_frame}: {crowds}>"

    def _repr_html_(self) -> str:
        from html import escape

        rows = "".join(f"<tr><th>{escape(name)}</th><td>{len(p):,}</td></tr>" for name, p in self.world.populations.items())
        return f"<p><b>{escape(repr(self)[1:-1].partition(':')[0])}</b></p><table>{rows}</table>"
