"""Which files a USD file may be made of, packages included; and that no answer about them is trusted."""

from __future__ import annotations

import io
import os
import re
import tempfile
import zipfile
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cases.hostile.usd import GOOD, HEAD, MESH

pytest.importorskip("pxr")

from antdsl.reader import client
from antdsl.reader.protocol import ReaderMessage
from antdsl.scene import Roots
from antdsl.scene.geometry import usd
from antdsl.scene.geometry.mesh_text import MeshError
from antdsl.scene.geometry.usd.closure import PackageError, make_package, read_layers
from antdsl.scene.geometry.usd.errors import clean_usd_text

NAMED = HEAD.replace("(\n", '(\n    defaultPrim = "ground"\n', 1)


def refers(path: str) -> str:
    return f'{NAMED}def "ground" (\nreferences = @{path}@\n)\n{{\n}}\n'


FORMS: dict[str, Callable[[str], str]] = {
    "reference": refers,
    "payload": lambda path: refers(path).replace("references", "payload"),
    "sublayer": lambda path: NAMED.replace("(\n", f"(\n    subLayers = [@{path}@]\n", 1) + MESH,
    "variant": lambda path: (
        f'{NAMED}def "ground" (\nvariants = {{ string look = "a" }}\nprepend variantSets = "look"\n)\n'
        f'{{\nvariantSet "look" = {{\n"a" (\nreferences = @{path}@\n) {{\n}}\n}}\n}}\n'
    ),
}


def zipped(members: dict[str, str | bytes], change: Callable[[zipfile.ZipInfo], None] = lambda entry: None) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, data in members.items():
            entry = zipfile.ZipInfo(name)
            change(entry)
            archive.writestr(entry, data)
    return file.getvalue()


def read(folder: Path, name: str, prim: str = "/ground", **granted: Path) -> usd.UsdMesh:
    stage = usd.open_stage(Roots(folder, granted), name, prim, up="y", frames=range(1, 2), fps=Fraction(24))
    return usd.read_usd_mesh(stage)


def refused(folder: Path, name: str) -> str:
    with pytest.raises(usd.UsdError) as error:
        read(folder, name)
    assert error.value.code in ("bad-path", "bad-usd", "no-such-file", "not-a-file") and str(error.value).isprintable()
    return str(error.value)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A project, with files of every kind beside it."""
    project = tmp_path / "project"
    project.mkdir()
    (tmp_path / "file.usda").write_text(NAMED + MESH)
    (tmp_path / "closed.usda").write_text(NAMED + MESH)
    (tmp_path / "closed.usda").chmod(0)
    os.mkfifo(tmp_path / "pipe.usda")
    (tmp_path / "folder.usda").mkdir()
    (tmp_path / "link.usda").symlink_to(tmp_path / "pipe.usda")
    return project


OUTSIDE = ("file", "closed", "pipe", "folder", "link", "nothing")


@pytest.mark.parametrize("inside", [False, True], ids=["layer", "package"])
@pytest.mark.parametrize("form", FORMS)
def test_no_message_says_whether_a_file_outside_exists(form: str, inside: bool, folder: Path) -> None:
    for start in (f"{folder.parent}/", "../", "./../", "sub/../../", "//" + str(folder.parent) + "/"):
        messages = set()
        for name in OUTSIDE:
            text = FORMS[form](f"{start}{name}.usda")
            (folder / "a.usda").write_text(text)
            (folder / "a.usdz").write_bytes(zipped({"top.usda": text}))
            # a long path is cut, with or without its name
            messages.add(re.sub("`[^`]*`", "PATH", refused(folder, "a.usdz" if inside else "a.usda"), count=1))
        assert len(messages) == 1, messages


@pytest.mark.parametrize(
    "path", ["file:///etc/passwd.usda", "http://host/a.usda", "C:/a.usda", "\\\\host\\a.usda", "$HOME/a.usda"]
)
def test_urls_are_rejected(path: str, folder: Path) -> None:
    (folder / "a.usda").write_text(refers(path))
    (folder / "a.usdz").write_bytes(zipped({"top.usda": refers(path)}))
    refused(folder, "a.usda")
    refused(folder, "a.usdz")


def test_links_and_value_clips_are_refused_in_a_project(folder: Path) -> None:
    for name in ("pipe", "folder", "link"):
        os.symlink(folder.parent / f"{name}.usda", folder / f"{name}.usda")
        (folder / "a.usda").write_text(refers(f"{name}.usda"))
        assert "link" in refused(folder, "a.usda")
    pipe = f"dictionary default = {{ asset[] assetPaths = [@{folder.parent}/pipe.usda@] }}"
    clips = f'{NAMED}def "ground" ( clips = {{ {pipe} }} ) {{}}'
    (folder / "a.usdz").write_bytes(zipped({"top.usda": refers("b.usda"), "b.usda": clips}))
    assert "value clips" in refused(folder, "a.usdz")


def test_layers_of_a_package_are_found_as_usd_finds_them(folder: Path) -> None:
    texture = f'{GOOD}def Shader "s"\n{{\nasset inputs:file = @{folder.parent}/pipe.usda@\n}}\n'
    members: dict[str, str | bytes] = {
        "top.usda": refers("./parts/a.usda"), "parts/a.usda": refers("b.usda"), "parts/b.usda": refers("other/c.usda"),
        "other/c.usda": texture.replace("(\n", '(\n    defaultPrim = "ground"\n', 1), "wood.png": b"no image",
    }  # fmt: skip
    (folder / "set.usdz").write_bytes(zipped(members))
    assert len(read(folder, "set.usdz").raw_mesh.faces) == 2
    for path in ("set.usdz", "./set.usdz", "set.usdz[other/c.usda]"):
        (folder / "a.usda").write_text(refers(path))
        assert len(read(folder, "a.usda").raw_mesh.faces) == 2, path
    for path in ("set.usdz[gone.usda]", "a.usda[b.usda]", "set.usdz[../a.usda]"):
        (folder / "b.usda").write_text(refers(path))
        (folder / "a.usda").write_text(refers("b.usda"))
        refused(folder, "a.usda")
    (folder / "set.usdz").write_bytes(zipped({"top.usda": refers("inner.usdz"), "inner.usdz": zipped({"a.usda": GOOD})}))
    assert "not a layer of that package" in refused(folder, "set.usdz")


def test_compressed_packages_are_rejected() -> None:
    def compressed(entry: zipfile.ZipInfo) -> None:
        entry.compress_type = zipfile.ZIP_DEFLATED

    def linked(entry: zipfile.ZipInfo) -> None:
        entry.create_system, entry.external_attr = 3, 0o120777 << 16

    good = zipped({"a.usda": GOOD})
    locked = bytearray(good)
    for mark, place in ((b"PK\1\2", 8), (b"PK\3\4", 6)):
        locked[locked.index(mark) + place] |= 1
    with pytest.warns(UserWarning, match="Duplicate"):
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w") as archive:
            for _ in range(2):
                archive.writestr("a.usda", GOOD)
    cases = {
        "leaves": [
            zipped({name: GOOD}) for name in ("/a.usda", "../a.usda", "b/../../a.usda", "a\\b.usda", "c:a.usda", "a[b].usda")
        ],
        "two members": [file.getvalue()],
        "compressed": [zipped({"a.usda": GOOD}, compressed)],
        "encrypted": [bytes(locked)],
        "link": [zipped({"a.usda": GOOD}, linked)],
        "begin": [zipped({"a.png": b""}), zipped({"a.png": b"", "a.usda": GOOD}), zipped({})],
        "damaged": [b"", b"PK", good[:-9], good[: len(good) // 2], good.replace(b"points", b"pointz", 1), bytes(99)],
        "are not read": [good[:-14] + b"\xff\xff\xff\xff" + good[-10:]],
    }
    for words, packages in cases.items():
        for data in packages:
            with pytest.raises(PackageError, match=words):
                read_layers(data)
    layers = read_layers(zipped({"a.usda": GOOD, "b/c.usda": "x", "t.png": b"y"}))
    assert list(layers) == ["a.usda", "b/c.usda"]
    again = make_package(layers)
    assert read_layers(again) == layers
    with zipfile.ZipFile(io.BytesIO(again)) as archive:
        for entry in archive.infolist():
            start = entry.header_offset + 30 + len(entry.filename) + len(entry.extra)
            assert start % 64 == 0 and again[start : start + 1] in (b"#", b"x")


# ---- messages


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("b\\c.usda", r"the path `b\c.usda` has a backslash (named by `a.usda`)"),
        ("gone.usda", "there is no file `gone.usda` (named by `a.usda`)"),
        ("B.usda", "there is no file `B.usda`; `b.usda` differs by case only (named by `a.usda`)"),
        ("b.usda?a=1", "`b.usda?a=1`, named by `a.usda`, is not one of .usd, .usda, .usdc, .usdz"),
        ("b.png", "`b.png`, named by `a.usda`, is not one of .usd, .usda, .usdc, .usdz"),
        ("file:///b.usda", "`file:///b.usda`, named by `a.usda`, is an address, not a file"),
    ],
)
def test_a_message_says_which_layer_names_a_file(path: str, words: str, folder: Path) -> None:
    (folder / "b.usda").write_text(GOOD)
    (folder / "a.usda").write_text(refers(path))
    assert refused(folder, "a.usda") == words


CYCLE = 'class "A" (\ninherits = </B>\n)\n{\n}\nclass "B" (\ninherits = </A>\n)\n{\n}\ndef "ground" (\ninherits = </A>\n)\n{\n}\n'


def test_messages_of_usd_are_the_same_in_each_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "inner.usda").write_text(NAMED + CYCLE)
    (folder / "outer.usda").write_text(refers("inner.usda"))
    (folder / "text.usda").write_text(f'{NAMED}def "ground" (\nreferences = \n')
    for name in ("inner.usda", "outer.usda", "text.usda"):
        messages = set()
        for _ in range(2):
            monkeypatch.setattr(client, "_file_reader", client.FileReader())  # another folder, and other addresses
            messages.add(refused(folder, name))
            client.end_reader()
        assert len(messages) == 1, messages
        assert "0x" not in str(messages) and "session" not in str(messages) and "antdsl-reader" not in str(messages)
    (folder / "inner.usda").write_text(NAMED + CYCLE)
    assert "@inner.usda@</A> which inherits from: @inner.usda@</B>" in refused(folder, "inner.usda")


def test_messages_of_usd_contain_no_memory_address() -> None:
    words = clean_usd_text(
        "@/tmp/x/sub/a.usda@,@anon:0x5565f6d2:a-session.usda@</m>\n on @anon:0x7f:b.usda@ <0x55a0> @anon:0x1@", "/tmp/x"
    )
    assert words == "@sub/a.usda@</m> on @b.usda@ @@"


def test_a_relative_folder_for_temporary_files(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "a.usda").write_text(GOOD)
    monkeypatch.chdir(folder)
    for place in (".", "temporary"):
        (folder / place).mkdir(exist_ok=True)
        monkeypatch.setattr(tempfile, "tempdir", place)
        monkeypatch.setattr(client, "_file_reader", client.FileReader())
        assert len(read(folder, "a.usda").raw_mesh.faces) == 2
        client.end_reader()
        assert not list((folder / place).glob("antdsl-reader-*"))


# ---- answers


def answer(arrays: dict[str, Any], **document: Any) -> ReaderMessage:
    return ReaderMessage({"passed_over": [], **document}, arrays)


MESH_ARRAYS = {"vertices": np.eye(3), "faces": np.array([[0, 1, 2]])}
MOVES = {"moves:group": np.zeros(3, np.int32), "moves:tracks": np.zeros((1, 1, 3, 4)), "moves:bent": np.zeros(0, np.int64),
         "moves:offsets": np.zeros((0, 0, 3))}  # fmt: skip
POINTS = {"places": np.zeros((1, 2, 3)), "radius": np.zeros(2), "ahead": np.zeros((2, 3)),
          "names:lengths": np.array([1, 1]), "names:bytes": np.array([65, 66], np.uint8)}  # fmt: skip


@pytest.mark.parametrize(
    ("read_it", "message"),
    [
        (usd.read_usd_mesh, answer({})),
        (usd.read_usd_mesh, answer({**MESH_ARRAYS, "faces": np.array([[0, 1, 3]])})),
        (usd.read_usd_mesh, answer({**MESH_ARRAYS, "faces": np.array([[0, -1, 2]])})),
        (usd.read_usd_mesh, answer({**MESH_ARRAYS, "vertices": np.full((3, 3), np.nan)})),
        (usd.read_usd_mesh, answer({**MESH_ARRAYS, "vertices": np.zeros((3, 2))})),
        (usd.read_usd_mesh, answer(MESH_ARRAYS, passed_over=1)),
        (usd.read_usd_mesh, answer({**MESH_ARRAYS, **MOVES, "moves:group": np.array([0, 0, 1], np.int32)})),
        (usd.read_usd_mesh, answer({**MESH_ARRAYS, **MOVES, "moves:tracks": np.zeros((1, 2, 3, 4))})),
        (usd.read_usd_mesh, answer({**MESH_ARRAYS, **MOVES, "moves:bent": np.array([7]), "moves:offsets": np.zeros((1, 1, 3))})),
        (usd.read_usd_points, answer(POINTS, values=[], texts=[])),
        (usd.read_usd_points, answer({**POINTS, "radius": np.zeros(3)}, values=[], texts=[], unit=1.0)),
        (usd.read_usd_points, answer(POINTS, values=["a"], texts=[], unit=1.0)),
        (usd.read_usd_points, answer({**POINTS, "places": np.full((1, 2, 3), np.inf)}, values=[], texts=[], unit=1.0)),
        (usd.read_usd_curve, answer({"places": np.zeros((1, 1, 3))})),
        (usd.read_usd_curve, answer({"places": np.zeros((3, 5, 3))})),
        (usd.read_usd_camera, answer({"at": np.zeros((1, 3))})),
    ],
)
def test_invalid_answers_are_errors(
    read_it: Callable[[usd.UsdStage], Any], message: ReaderMessage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.usda").write_text(GOOD)
    stage = usd.open_stage(Roots(tmp_path, {}), "a.usda", "/ground", up="y", frames=range(1, 2), fps=Fraction(24))
    monkeypatch.setattr(client, "send_request", lambda *_, **__: message)
    with pytest.raises((usd.UsdError, MeshError)):
        read_it(stage)


def test_usd_needs_a_grant_where_nothing_confines_the_reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.usda").write_text(GOOD)
    monkeypatch.setattr(client, "find_active_layers", lambda: {"rlimits": 1, "landlock": 0, "seccomp": 0})
    with pytest.raises(usd.UsdError, match="no sandbox") as error:
        read(tmp_path, "a.usda")
    assert error.value.help is not None and "--trust-usd" in error.value.help
    monkeypatch.setenv("ANTDSL_TRUST_USD", "1")
    assert len(read(tmp_path, "a.usda").raw_mesh.faces) == 2
