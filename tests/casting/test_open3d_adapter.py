"""Open3D is loaded without the web server and the HTTP client that its plots need; the plots work all the same."""

from __future__ import annotations

import subprocess
import sys

import pytest

LOAD = """
import sys
def seen(event, arguments):
    if event in ("socket.bind", "socket.connect", "subprocess.Popen", "os.exec", "os.posix_spawn"):
        print("event", event, arguments)
sys.addaudithook(seen)
from antdsl.casting.open3d_module import load_open3d
loaded = load_open3d()
assert loaded.t.geometry.RaycastingScene(nthreads=1)
print("web", sorted({"dash", "flask", "requests", "urllib3"} & set(sys.modules)))
"""
PLOT = """
box = loaded.geometry.TriangleMesh.create_box()
box.compute_vertex_normals()
figure = loaded.visualization.get_plotly_fig([box])
from open3d.visualization.draw_plotly import draw_plotly
print(type(figure).__name__, callable(draw_plotly), "dash" in sys.modules)
"""


def printed(program: str) -> str:
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout


def test_loading_open3d_binds_no_socket_and_starts_no_program() -> None:
    assert printed(LOAD) == "web []\n"


@pytest.mark.slow
def test_plots_of_open3d_load_on_demand() -> None:
    assert printed(LOAD + PLOT).splitlines()[-1] == "Figure True True"
