"""The films of the examples: their scenes exist and have the cameras and frames that the films need."""

from __future__ import annotations

from example_films import EXAMPLES, FILMS, SECONDS

from antdsl.scene.load import load_scene


def test_scenes_of_films_have_their_cameras_and_frames() -> None:
    for name, film in FILMS.items():
        scene, report = load_scene(EXAMPLES / film.scene)
        assert scene is not None and report.ok, name
        model = scene.model
        assert model.frames.first <= film.first and film.first + SECONDS * model.fps <= model.frames.last + 1, name
        if "--camera" in film.words:
            assert film.words[film.words.index("--camera") + 1] in model.named_cameras, name
