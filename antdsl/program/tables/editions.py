"""Defaults that differ between editions of the language, with one row for each setting of a species.

A file uses the defaults of its edition. `antdsl fmt --edition` writes the previous defaults into the text (`upgrade.py`), so
that an upgraded program has the same results. A new setting needs a row only if edition 1 behaves differently from its default.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

NO_LIMIT_WORD = "none"  # the value of a limit that does not apply
# Settings of a species that are equal for all agents, with their help. They are not attributes and cannot be read or assigned.
SWITCH_HELP = {
    "body_clearance": "whether trunk, head and abdomen stay outside every surface, obstacle and solid",
    "body_contacts": "whether head, abdomen and a carried load take room in contacts, not only a trunk that all bodies share",
}
SWITCH_EDITION = 2  # the first edition with switches


@dataclass(frozen=True, slots=True)
class EditionDefault:
    """The defaults of one setting of a species in all editions.

    `defaults`: for each edition in order, the default as text in the language; "" if a species must set it. `reason`: why a
    newer default differs."""

    setting: str
    defaults: tuple[str, ...]
    reason: str

    def get_default(self, edition: int) -> str:
        """Return the default in an edition as text in the language; "" if a species must set it."""
        return self.defaults[edition - 1]

    def format_setting_line(self, edition: int) -> str:
        """Return the line that sets the default of an edition explicitly in the text of a species."""
        return f"{self.setting} {self.get_default(edition)}"


# Defaults of species with standing bodies, which set `height` instead of `size`.
STANDING_DEFAULTS = {"body_clearance": "false", "upright": "100 %", "max_slope": "40 deg"}
STANDING_SIZE_SETTING, CRAWLING_SIZE_SETTING = "height", "size"
# Attributes with a register only in species that set them; all other species have this value.
OPTIONAL_ATTRIBUTES = {"min_speed": 0.0, "upright": 0.0, "max_slope": inf, "crouch": 1.0}

EDITION_DEFAULTS = (
    EditionDefault("body_clearance", ("false", "true"), "bodies were drawn inside the ground and walls"),
    EditionDefault("body_contacts", ("false", "true"), "heads, wide abdomens and loads were drawn inside other bodies"),
    EditionDefault("size", ("4 mm", ""), "a species says how large it is: by `size`, or by `height` if its body stands"),
    EditionDefault(
        "max_turn", ("none", "max(90 deg * max_speed / size, 600 deg/s)"), "kinematic agents turned round in one frame"
    ),
)
DEFAULT_BY_SETTING = {row.setting: row for row in EDITION_DEFAULTS}


def find_setting_defaults(edition: int, is_standing: bool) -> dict[str, str]:
    """Return, by name, the species settings with a default that depends on the edition. The values are these defaults as text in
    the language.

    "" means that the species must set it. `is_standing`: whether the species sets its height."""
    defaults = {row.setting: row.get_default(edition) for row in EDITION_DEFAULTS}
    if is_standing:
        del defaults[CRAWLING_SIZE_SETTING]
        defaults = {STANDING_SIZE_SETTING: "", **defaults, **STANDING_DEFAULTS}
    return defaults
