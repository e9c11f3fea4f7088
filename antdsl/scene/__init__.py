"""A scene: real geometry and numbers for a program. `load` reads one."""

from antdsl.scene.load import Scene, load, load_text
from antdsl.scene.paths import PathRefused, Roots

__all__ = ["PathRefused", "Roots", "Scene", "load", "load_text"]
