"""The user's key for machine code: created once however many processes want it at once, replaced where others may know it, and
never read from a folder that a project could name."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from children import child_environment

from antdsl import user_folders
from antdsl.machine_code import object_cache, signing
from antdsl.machine_code.object_cache import CACHE_VARIABLE, ObjectCache
from antdsl.user_folders import NotPrivateError

KEY = "0123456789abcdef" * 4
rights = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="this system says in other ways who may read")


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(user_folders, "home_folder", lambda: tmp_path / "home")
    monkeypatch.setattr(user_folders, "_find_local_app_data", lambda: tmp_path / "home")
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)
    (tmp_path / "home").mkdir(mode=0o700)
    return tmp_path / "home"


def signature(*, create: bool = True) -> bytes | None:
    """What the user's signer makes of some code; None where there is no key."""
    signer = signing.get_signer(create=create)
    return None if signer is None else signer.sign(KEY, b"code")


def test_a_key_is_created_when_something_is_signed_and_lasts() -> None:
    assert signature(create=False) is None and not signing.find_key_path().parent.exists()
    first = signature()
    assert first is not None and len(first) == signing.SIGNATURE_BYTES
    assert signature() == signature(create=False) == first
    assert [each.name for each in signing.find_key_path().parent.iterdir()] == ["key"], "no part is left behind"


def test_a_signature_is_of_key_and_content() -> None:
    signer = signing.get_signer(create=True)
    assert signer is not None
    own_signature = signer.sign(KEY, b"code")
    assert signer.is_signed(KEY, b"code", own_signature)
    other = KEY[:-1] + "0"
    for key, data, candidate in (
        (other, b"code", own_signature),
        (KEY, b"code\0", own_signature),
        (KEY, b"cod", own_signature),
        (KEY, b"", own_signature),
    ):
        assert not signer.is_signed(key, data, candidate)
    for wrong in (own_signature[:-1], own_signature + b"\0", b"", bytes(32)):
        assert not signer.is_signed(KEY, b"code", wrong)
    assert signer.make_file_name(KEY) != signer.make_file_name(other) and len(signer.make_file_name(KEY)) == 64
    assert bytes.fromhex(signer.make_file_name(KEY)) != signer.sign(KEY, b"")


@pytest.mark.parametrize(
    "kind", ["link", "dangling link", "loop", "pipe", "hard link", "short", "long", "empty", "read", "written"]
)
@rights
def test_a_key_that_others_may_know_or_have_made_is_replaced(home: Path, tmp_path: Path, kind: str) -> None:
    old_signature = signature()
    path, elsewhere = signing.find_key_path(), tmp_path / "elsewhere"
    secret = path.read_bytes()
    if kind in ("short", "long", "empty"):
        path.write_bytes({"short": secret[:-1], "long": secret + b"\n", "empty": b""}[kind])
    elif kind in ("read", "written"):
        path.chmod(0o640 if kind == "read" else 0o602)
    elif kind == "hard link":
        os.link(path, elsewhere)
    else:
        path.rename(elsewhere)
        if kind == "pipe":
            os.mkfifo(path)
        else:
            path.symlink_to({"link": elsewhere, "dangling link": tmp_path / "nowhere", "loop": path}[kind])
    assert signature(create=False) is None
    new_signature = signature()
    assert new_signature not in (None, old_signature) and signature() == new_signature
    assert path.stat().st_mode & 0o777 == 0o600 and not path.is_symlink() and path.read_bytes() != secret
    assert not (tmp_path / "nowhere").exists()
    if elsewhere.exists():
        assert elsewhere.read_bytes() == secret, "what lies elsewhere is left alone"


@rights
def test_a_key_of_another_user_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    signature()
    secret, own = signing.find_key_path().read_bytes(), os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: own + 1)
    assert signature(create=False) is None
    with pytest.raises(NotPrivateError, match="another user"):
        signature()
    assert signing.find_key_path().read_bytes() == secret


@pytest.mark.parametrize(
    ("kind", "why"),
    [("folder in place of the key", ""), ("link", "is a link"), ("open to others", "may write"), ("file", ""), ("read-only", "")],
)
@rights
def test_where_there_can_be_no_key_code_stays_in_memory(
    home: Path, tmp_path: Path, kind: str, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the user names a folder for it: without a key nothing in there can be trusted."""
    above = signing.find_key_path().parent
    above.parent.mkdir(parents=True, exist_ok=True)
    if kind == "folder in place of the key":
        (above / "key").mkdir(parents=True)
    elif kind == "link":
        (tmp_path / "other").mkdir(mode=0o700)
        above.symlink_to(tmp_path / "other")
    elif kind == "open to others":
        above.mkdir()
        above.chmod(0o775)
    elif kind == "file":
        above.write_bytes(b"")
    else:

        def refuse(*_: object, **__: object) -> None:
            raise OSError(30, "Read-only file system")

        for call in ("mkdir", "link"):
            monkeypatch.setattr(os, call, refuse)
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "named"))
    cache = ObjectCache()
    for _ in range(3):
        cache.store_bytes(KEY, b"code")
        assert cache.get(KEY) == b"code"
    [message] = cache.messages
    assert "private key" in message and why in message
    assert not (tmp_path / "named").exists()
    assert ObjectCache().get(KEY) is None


_STARTER = """
import sys
from pathlib import Path
from antdsl import user_folders
from antdsl.machine_code import signing

user_folders.home_folder = user_folders._find_local_app_data = lambda: Path(sys.argv[1])
sys.stdin.read(1)
print(signing.get_signer(create=True).sign("", b"").hex())
"""


@pytest.mark.parametrize("previous_key", ["nothing", "empty"])
def test_processes_that_begin_at_once_have_one_key(home: Path, previous_key: str) -> None:
    """However many create it: all but one find the name taken, and read what that one wrote. One that a damaged key is replaced
    by lasts as well."""
    if previous_key == "empty":
        signature()
        signing.find_key_path().write_bytes(b"")
    command = [sys.executable, "-c", _STARTER, str(home)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    all_of_them = [subprocess.Popen(command, text=True, env=child_environment(), **pipes) for _ in range(6)]  # type: ignore[call-overload]
    for each in all_of_them:
        each.stdin.write("x")
        each.stdin.flush()
    key_texts = []
    for each in all_of_them:
        out, problems = each.communicate(timeout=120)
        assert each.returncode == 0, problems
        key_texts.append(out.strip())
    key = signing.get_signer(create=False)
    assert key is not None and key.sign("", b"").hex() in key_texts
    assert previous_key == "empty" or len(set(key_texts)) == 1
    assert [each.name for each in signing.find_key_path().parent.iterdir()] == ["key"]


def test_threads_that_begin_at_once_have_one_key() -> None:
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(16) as pool:
        signatures = set(pool.map(lambda _: signature(), range(64)))
    assert len(signatures) == 1 and None not in signatures


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has known folders instead")
@pytest.mark.parametrize("entry", ["none", "relative", "empty", "missing"])
def test_a_user_without_a_home_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, entry: str) -> None:
    """As in a container that runs under any number."""
    import pwd

    monkeypatch.undo()

    def get_user(number: int) -> pwd.struct_passwd:
        if entry == "none":
            raise KeyError(number)
        home = {"relative": "home", "empty": "", "missing": str(tmp_path / "missing")}[entry]
        return pwd.struct_passwd(("user", "x", number, number, "", home, ""))

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(pwd, "getpwuid", get_user)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)
    with pytest.raises(FileNotFoundError):
        user_folders.home_folder()
    cache = ObjectCache()
    cache.store_bytes(KEY, b"code")
    assert cache.get(KEY) == b"code" and len(cache.messages) == 1 and "home folder" in cache.messages[0]
    assert not (tmp_path / "missing").exists() and not (tmp_path / "home" / ".cache").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has known folders instead")
def test_the_home_is_that_of_the_password_database(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    import pwd

    monkeypatch.undo()
    for name in ("HOME", "XDG_CACHE_HOME", "XDG_STATE_HOME", "LOGNAME", "USER"):
        monkeypatch.setenv(name, str(tmp_path))
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)
    assert user_folders.home_folder() == Path(pwd.getpwuid(os.geteuid()).pw_dir)
    assert not user_folders.state_folder().is_relative_to(tmp_path)
    assert object_cache.ObjectCache()._folder == user_folders.cache_folder() / "antdsl" / "native"
