"""A scene: real geometry and numbers for a program. `load` reads one.

`document` reads YAML with a place for every value, `inheritance` joins what a scene extends, `model` types it, `matching`
holds it against a program, `staging` reads its files (`geometry`) and gives the `Setting`: all that the run time gets, in mm,
seconds and the scene's own axes. `paths` is the one door to files that a scene or a program names."""

from antdsl.scene.load import Scene, load, load_text
from antdsl.scene.paths import PathRefused, Roots

__all__ = ["PathRefused", "Roots", "Scene", "load", "load_text"]
