"""`check` says how long a step is compared with the body, and how many substeps are needed."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from antdsl.pipeline import check_path

MINIMAL = Path(__file__).resolve().parents[2] / "examples" / "minimal"
WALKER = """ant 1
world {{ surface ground }}
species walker {{
  param pace = 400 mm/s in 0 mm/s .. 10 m/s
  size {size}
  max_speed {speed}
  start go
  state go {{ steer heading }}
}}
"""


def findings(folder: Path, scene: str, size: str = "4 mm", speed: str = "pace", body: str = "ball") -> list[str]:
    """The helps of the warnings about long steps, each with the line of the scene."""
    shutil.copy(MINIMAL / "ground.ply", folder)
    (folder / "walker.ant").write_text(WALKER.format(size=size, speed=speed))
    text = f"antdsl: 1\n{scene}\nworld: {{ground: {{mesh: ground.ply}}}}\n"
    text += f"crowd: [{{species: walker, from: walker.ant, count: 1, body: {body}}}]\n"
    (folder / "scene.yaml").write_text(text)
    _, report = check_path(folder / "scene.yaml")
    assert report.ok
    return [f"{d.span.source.find_line_column(d.span.start)[0]}: {d.help}" for d in report.diagnostics if d.code == "long-step"]


@pytest.mark.parametrize(
    ("scene", "expected"),
    [
        ("contacts: hard", "4: write `substeps: 5`"),  # 400 / 24 / 4 = 4.2
        ("contacts: soft", "4: write `substeps: 5`"),
        ("contacts: hard\nsubsteps: 2", "3: write `substeps: 5`"),
        ("contacts: hard\nsubsteps: 5", ""),
        ("contacts: off", ""),
        ("contacts: hard\nfps: 100", ""),
        ("contacts: hard\nset: {walker.pace: 60 mm/s}", ""),
        ("contacts: hard\nset: {walker.pace: 10 m/s}", "5: write a `max_speed` below 6.14 m/s"),
    ],
)
def test_substeps_follow_from_the_frame_rate_the_speed_and_the_body(scene: str, expected: str, tmp_path: Path) -> None:
    assert findings(tmp_path, scene) == ([expected] if expected else [])


@pytest.mark.parametrize(
    ("size", "speed", "body", "count"),
    [
        ("uniform(3 mm, 5 mm)", "normal(200 mm/s, 10 mm/s)", "ball", "3"),  # 8.3 of 4
        ("4 mm", "200 mm/s", "ant", "3"),  # 8.3 of 3.68
        ("4 mm", "100 * size / 1 s", "ball", None),  # computed
        ("4 mm", "90 mm/s", "ball", None),
    ],
)
def test_draws_count_with_their_mean_and_computed_values_not_at_all(
    size: str, speed: str, body: str, count: str | None, tmp_path: Path
) -> None:
    expected = [f"4: write `substeps: {count}`"] if count else []
    assert findings(tmp_path, "contacts: hard", size, speed, body) == expected


def test_the_suggested_substeps_are_enough(tmp_path: Path) -> None:
    (finding,) = findings(tmp_path, "contacts: hard")
    count = re.search(r"substeps: (\d+)", finding)
    assert count and findings(tmp_path, f"contacts: hard\nsubsteps: {count[1]}") == []
    assert findings(tmp_path, f"contacts: hard\nsubsteps: {int(count[1]) - 1}") != []


@pytest.mark.parametrize(
    ("fps", "radius", "layer", "expected"),
    [
        (8, "0.22 m", "keep_clear(heading, within: 4 m)", ["write `fps: 10` or more"]),  # 1.4 / 8 = 0.175 m
        (12, "0.22 m", "keep_clear(heading, within: 4 m)", []),
        (8, "uniform(0.3 m, 0.4 m)", "keep_clear(heading, within: 4 m)", []),
        (8, "0.22 m", "match(clear_velocity(heading * max_speed, within: 3 m))", ["write `fps: 10` or more"]),
        (8, "0.22 m", "heading", []),
    ],
)
def test_agents_that_avoid_others_need_short_steps(
    fps: int, radius: str, layer: str, expected: list[str], tmp_path: Path
) -> None:
    shutil.copy(MINIMAL / "ground.ply", tmp_path)
    (tmp_path / "walker.ant").write_text(
        "ant 1\nuse steering\nworld { surface ground }\n"
        f"species walker {{ size 0.5 m; radius {radius}; max_speed 1.4 m/s; start go; state go {{ steer {layer} }} }}\n"
    )
    (tmp_path / "scene.yaml").write_text(
        f"antdsl: 1\nfps: {fps}\nworld: {{ground: {{mesh: ground.ply}}}}\n"
        "crowd: [{species: walker, from: walker.ant, count: 1, place: {on: ground}}]\n"
    )
    _, report = check_path(tmp_path / "scene.yaml")
    assert report.ok and [each.help for each in report.diagnostics if each.code == "late-avoidance"] == expected
