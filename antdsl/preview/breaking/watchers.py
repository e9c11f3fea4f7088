"""Breakpoints on three events: an agent enters a state, a spec fails, or an agent has a fault."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.preview.breaking.model import BreakpointError
from antdsl.preview.observing.observer import PauseReason
from antdsl.preview.observing.spec_judgement import CURVE_NAME_PREFIX, SpecObserver
from antdsl.preview.requests import FaultBreak, SpecBreak, StateBreak
from antdsl.preview.session import PreviewSession

_MAX_NAMED_AGENTS = 3  # maximum number of agents named in a message
MAX_SELECTED_AGENTS = 500  # maximum number of agents that a page selects


class StateWatcher:
    """A watcher that reports a hit when an agent enters a state.

    Agents that are born in the state, or change from the state to itself, do not count."""

    def __init__(self, session: PreviewSession, request: StateBreak) -> None:
        plan = session.shot.plan.species.get(request.species)
        if plan is None:
            raise _make_unknown_name_error("species", request.species, list(session.shot.plan.species))
        machine = next((each for each in plan.machines if each.name == request.machine), None)
        if machine is None:
            raise _make_unknown_name_error(
                f"machine of `{request.species}`", request.machine, [each.name for each in plan.machines]
            )
        if request.state not in machine.states:
            raise _make_unknown_name_error(f"state of `{request.species}`", request.state, list(machine.states))
        self.ask, self.state = request, machine.states.index(request.state)
        self.ids_in_other_states: NDArray[np.int64] = np.zeros(0, np.int64)  # ids of agents in other states

    def begin(self, session: PreviewSession) -> None:
        population = session.world.populations[self.ask.species]
        self.ids_in_other_states = population.ids[population.now[f"{self.ask.machine}.state"] != self.state]

    def check_frame(self, session: PreviewSession) -> PauseReason | None:
        population = session.world.populations[self.ask.species]
        ids_in_state = population.ids[population.now[f"{self.ask.machine}.state"] == self.state]
        entered = np.intersect1d(ids_in_state, self.ids_in_other_states)
        self.begin(session)
        if not len(entered):
            return None
        ids = tuple(int(each) for each in entered)
        line = f"{format_agents(self.ask.species, ids)} entered {self.ask.state} at frame {session.frame}"
        return PauseReason(line, self.ask.species, ids[:MAX_SELECTED_AGENTS])


def format_agents(species: str, ids: tuple[int, ...]) -> str:
    """Return a text that names agents of one species by their ids. Only the first few ids are listed."""
    words = f"{species} {', '.join(map(str, ids[:_MAX_NAMED_AGENTS]))}"
    return f"{words} and {len(ids) - _MAX_NAMED_AGENTS} more" if len(ids) > _MAX_NAMED_AGENTS else words


def _make_unknown_name_error(noun: str, name: str, known_names: list[str]) -> BreakpointError:
    near = find_nearest_name(name, known_names)
    listed = ", ".join(f"`{each}`" for each in known_names) or "none"
    return BreakpointError(f"there is no {noun} `{name}`", f"did you mean `{near}`?" if near else f"there is {listed}")


class SpecWatcher:
    """A watcher that reports a hit at the first frame in which a spec fails."""

    def __init__(self, session: PreviewSession, request: SpecBreak, specs: SpecObserver) -> None:
        known = dict(specs.plan_specs(session.shot, session.compiler.scene))
        if request.spec not in known:
            near = find_nearest_name(request.spec, known)
            help = f"did you mean `{near}`?" if near else ", ".join(f"`{each}`" for each in known) or "the program has no spec"
            raise BreakpointError(f"there is no spec `{request.spec}`", help)
        plan = known[request.spec]
        if isinstance(plan, str):
            raise BreakpointError(
                f"`{request.spec}` is not judged here: {plan}", f'`antdsl test` judges it: `--spec "{request.spec}"`'
            )
        self.ask, self.specs = request, specs

    def begin(self, session: PreviewSession) -> None:
        """Do nothing: earlier results of the spec are read from its curve."""

    def check_frame(self, session: PreviewSession) -> PauseReason | None:
        frame, curves, key = session.frame, session.timeline.curves, CURVE_NAME_PREFIX + self.ask.spec
        if curves.get(frame, {}).get(key) != 0.0 or curves.get(frame - 1, {}).get(key) == 0.0:
            return None
        judged = next((each.make_json_entry() for each in self.specs.statuses if each.name == self.ask.spec), None)
        if judged is None or judged["frame"] != frame:  # judged before an edit: the frame will be simulated and judged again
            return PauseReason(f"`{self.ask.spec}` fails at frame {frame}")
        return PauseReason(
            f"`{self.ask.spec}` fails at frame {frame}: {judged['message']}", judged["species"], tuple(judged["agents"])
        )


class FaultWatcher:
    """A watcher that reports a hit when an agent has a fault, even if the run would continue with this agent in quarantine."""

    def __init__(self, session: PreviewSession, request: FaultBreak) -> None:
        self.ask = request

    def begin(self, session: PreviewSession) -> None:
        """Do nothing, because the faults of each step are recorded with the step."""

    def check_frame(self, session: PreviewSession) -> PauseReason | None:
        fault = session.world.faults.fault_of_step
        return None if fault is None else PauseReason(fault.brief_text, fault.species, (fault.agent,))
