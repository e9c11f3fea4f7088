"""Explanations of what an agent did in a step, and why. The step is simulated again from a checkpoint and traced.

The modules that collect data are separate from those that format it."""

from antdsl.explain.history import CacheHistory, ExplainError, History, open_shot
from antdsl.explain.model import Explanation, make_json_document
from antdsl.explain.queries import explain_agent_in_cache, make_absence_error
from antdsl.explain.replaying import StepReplay
from antdsl.explain.state_timeline import merge_state_frames
from antdsl.explain.step_report import LocatedExplanation, explain_agents, explain_agents_with_positions
from antdsl.explain.text_report import format_explanation

__all__ = [
    "CacheHistory",
    "ExplainError",
    "Explanation",
    "History",
    "LocatedExplanation",
    "StepReplay",
    "explain_agent_in_cache",
    "explain_agents",
    "explain_agents_with_positions",
    "format_explanation",
    "make_absence_error",
    "make_json_document",
    "merge_state_frames",
    "open_shot",
]
