"""Explains an agent's step: the step is repeated from a checkpoint and traced. Data comes first; formatting is separate."""

from antdsl.explain.account import LocatedExplanation, explain_agents, locate_explanations
from antdsl.explain.history import CacheHistory, ExplainError, History, open_shot
from antdsl.explain.model import Explanation, as_json
from antdsl.explain.queries import absence_error, explain
from antdsl.explain.replaying import Replay
from antdsl.explain.strip import state_stretches
from antdsl.explain.text_report import tell

__all__ = [
    "CacheHistory",
    "ExplainError",
    "Explanation",
    "History",
    "LocatedExplanation",
    "Replay",
    "absence_error",
    "as_json",
    "explain",
    "explain_agents",
    "locate_explanations",
    "open_shot",
    "state_stretches",
    "tell",
]
