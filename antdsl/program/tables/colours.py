"""The colour names that an artist may write after a state's label, with their sRGB values.

The checker uses the names; caches and pictures use the values."""

from collections.abc import Mapping
from types import MappingProxyType

RgbTriple = tuple[int, int, int]

# Distinct from each other on sunlit soil: darker and less saturated than the web colours with these names.
COLOUR_BY_NAME: Mapping[str, RgbTriple] = MappingProxyType(
    {
        "amber": (242, 163, 31),
        "aqua": (70, 214, 214),
        "azure": (62, 142, 240),
        "beige": (222, 208, 170),
        "black": (28, 26, 26),
        "blue": (48, 102, 222),
        "bronze": (176, 118, 58),
        "brown": (124, 78, 44),
        "charcoal": (62, 64, 68),
        "copper": (190, 106, 66),
        "coral": (250, 120, 88),
        "cream": (248, 236, 204),
        "crimson": (196, 26, 62),
        "cyan": (38, 196, 220),
        "emerald": (22, 160, 106),
        "fuchsia": (226, 50, 186),
        "gold": (234, 188, 40),
        "gray": (142, 144, 148),
        "green": (66, 166, 62),
        "grey": (142, 144, 148),
        "indigo": (78, 58, 168),
        "ivory": (246, 242, 224),
        "jade": (30, 150, 112),
        "lavender": (184, 164, 232),
        "lilac": (196, 150, 214),
        "lime": (164, 214, 44),
        "magenta": (214, 40, 150),
        "maroon": (122, 32, 48),
        "mauve": (176, 126, 160),
        "mint": (130, 220, 172),
        "mustard": (208, 166, 44),
        "navy": (34, 52, 112),
        "ochre": (200, 132, 46),
        "olive": (124, 126, 48),
        "orange": (240, 118, 30),
        "peach": (250, 184, 142),
        "pink": (242, 132, 172),
        "plum": (134, 66, 124),
        "purple": (132, 66, 190),
        "red": (214, 48, 44),
        "rose": (232, 84, 120),
        "ruby": (170, 24, 58),
        "rust": (172, 78, 36),
        "salmon": (244, 144, 122),
        "sand": (216, 190, 142),
        "scarlet": (232, 54, 32),
        "sienna": (158, 88, 52),
        "silver": (190, 194, 200),
        "sky": (120, 186, 240),
        "slate": (98, 112, 130),
        "tan": (204, 170, 124),
        "teal": (26, 146, 146),
        "turquoise": (58, 204, 186),
        "umber": (96, 74, 54),
        "vermilion": (228, 72, 42),
        "violet": (150, 92, 222),
        "white": (244, 244, 240),
        "wine": (116, 34, 60),
        "yellow": (246, 218, 44),
    }
)

# Colours of states without a declared colour, by index. Neighbours in the list differ clearly.
DEFAULT_COLOUR_NAMES: tuple[str, ...] = (
    "amber",
    "blue",
    "green",
    "crimson",
    "teal",
    "violet",
    "yellow",
    "pink",
    "brown",
    "sky",
    "lime",
    "grey",
)


def find_rgb(name: str) -> RgbTriple | None:
    """Return the sRGB values (0 to 255) of the colour `name`, or None if there is no such colour."""
    return COLOUR_BY_NAME.get(name)


def choose_default_rgb(index: int) -> RgbTriple:
    """Return the sRGB values (0 to 255) for a state without a declared colour. `index`: the index of the state, from 0."""
    return COLOUR_BY_NAME[DEFAULT_COLOUR_NAMES[index % len(DEFAULT_COLOUR_NAMES)]]
