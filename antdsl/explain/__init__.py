"""Explains an agent's step: the step is repeated from a checkpoint and traced. Data comes first; formatting is separate."""

from antdsl.explain.account import Account, accounts, placed_accounts
from antdsl.explain.history import CacheHistory, ExplainError, History, open_shot
from antdsl.explain.model import Explanation, as_json
from antdsl.explain.queries import absent, explain
from antdsl.explain.replaying import Replay
from antdsl.explain.strip import stretches
from antdsl.explain.text_report import tell

__all__ = [
    "Account",
    "CacheHistory",
    "ExplainError",
    "Explanation",
    "History",
    "Replay",
    "absent",
    "accounts",
    "as_json",
    "explain",
    "open_shot",
    "placed_accounts",
    "stretches",
    "tell",
]
