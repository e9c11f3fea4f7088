"""Many files checked at once: shared out to processes or not, with a process that dies or not, the same is found."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from unittest.mock import patch

import pytest

from antdsl import checking
from antdsl.diagnostics import Diagnostic, Fix, Label, Report
from antdsl.diagnostics.transfer import decode_reports, encode_reports
from antdsl.files import find_files
from antdsl.pipeline import RunChoices
from antdsl.source import Source, Span

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = [ROOT / "examples", ROOT / "tests" / "cases", ROOT / "tests" / "programs"]
SHARES = sys.platform == "linux"


def place(span: Span | None) -> tuple[object, ...] | None:
    return span and (span.source.path, span.source.text, span.source.part_number, span.start, span.end)


def labels(diagnostic: Diagnostic) -> list[tuple[object, ...]]:
    return [(place(label.span), label.text) for label in diagnostic.labels]


def check_files(files: list[Path], monkeypatch: pytest.MonkeyPatch, cores: int) -> tuple[list[tuple[object, ...]], list[str]]:
    monkeypatch.setattr(checking, "_can_fork", lambda: True)  # whatever other tests have imported
    checked = checking.check_files(files, RunChoices(), cores=cores)
    assert set(checked.reports) == set(files)
    findings = [
        (file, d.code, d.message, d.severity, d.help, place(d.span), labels(d), d.fix and (place(d.fix.span), d.fix.text))
        for file in files
        for d in checked.reports[file].diagnostics
    ]
    return findings, sorted((source.path, source.text) for source in checked.sources)  # type: ignore[return-value]


@pytest.mark.skipif(not SHARES, reason="processes are forked on Linux only")
def test_several_processes_report_the_same_findings(monkeypatch: pytest.MonkeyPatch) -> None:
    files, _ = find_files(FOLDERS)
    assert len(files) > checking.MIN_FILES_FOR_PROCESSES
    one = check_files(files, monkeypatch, 1)
    assert len(one[0]) > 300
    assert check_files(files, monkeypatch, 3) == one


@pytest.mark.skipif(not SHARES, reason="processes are forked on Linux only")
def test_files_of_a_dead_process_are_checked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    files, _ = find_files(FOLDERS[1:])
    one = check_files(files, monkeypatch, 1)

    def dies(pipe: int, groups: list[list[Path]], claims: int, *arguments: object) -> None:
        os.read(claims, 1)  # it has taken a group with it
        os._exit(9)

    monkeypatch.setattr(checking, "_check_in_child", dies)
    assert check_files(files, monkeypatch, 2) == one


@pytest.mark.skipif(not SHARES, reason="processes are forked on Linux only")
def test_incomplete_answers_are_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    files, _ = find_files(FOLDERS[1:])
    one = check_files(files, monkeypatch, 1)
    encode = checking.encode_reports
    monkeypatch.setattr(checking, "encode_reports", lambda *arguments: encode(*arguments)[:-100])
    assert check_files(files, monkeypatch, 2) == one


def test_reports_come_back_complete_and_share_their_texts() -> None:
    text = Source("a \ud800.ant", "ant 1\nspecies é\x00\n", 2)
    other = Source("b.ant", "")
    span = Span(text, 2, 9)
    full = Diagnostic("code", "message", span, "warning", "help", (Label(Span(other, 0, 0), "why"),), Fix(span, "new"))
    report = Report([full, Diagnostic("bare", "m", None)], [Diagnostic("answered", "m", span)])
    reports, sources = decode_reports(encode_reports({Path("x/a.ant"): report, Path("b"): Report()}, [text, other]))
    assert repr(reports) == repr({Path("x/a.ant"): report, Path("b"): Report()})
    assert [repr(source) for source in sources] == [repr(text), repr(other)]
    (first, _) = reports[Path("x/a.ant")].diagnostics
    assert first.span is not None and first.span.source is sources[0] and first.labels[0].span.source is sources[1]
    reports[Path("x/a.ant")].add(full)
    assert len(reports[Path("x/a.ant")].diagnostics) == 2  # the same complaint is known


@pytest.mark.parametrize("data", [b"", b"{", b"[]", b"{}", b'{"table": [], "sources": [0], "reports": []}', b"\xff"])
def test_invalid_reports_are_errors(data: bytes) -> None:
    with pytest.raises(ValueError):
        decode_reports(data)


def test_files_that_use_each_other_are_checked_in_one_process(tmp_path: Path) -> None:
    for name in ("a/one.ant", "a/deep/two.ant", "b/three.ant", "ab/four.ant"):
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("ant 1\n")
    files = sorted(tmp_path.rglob("*.ant"))
    groups = {frozenset(file.name for file in group) for group in checking._group_files(files)}
    assert groups == {frozenset({"one.ant", "two.ant"}), frozenset({"three.ant"}), frozenset({"four.ant"})}


def test_slow_files_are_reported_and_others_are_checked(tmp_path: Path) -> None:
    slow, fine = tmp_path / "slow.ant", tmp_path / "fine.ant"
    for file in (slow, fine):
        file.write_text("ant 1\nspecies moth { state a { }\nlayers { state } }\n")

    def spin(path: Path, *words: object, **options: object) -> object:
        try:
            while path == slow:
                pass
        except Exception:
            raise AssertionError("a handler of Exception sees it") from None
        return None, Report()

    with patch.object(checking, "check_path", spin):
        results = checking.check_files([slow, fine], RunChoices(), cpu_seconds=0.05)
    (error,) = results.reports[slow].errors
    assert error.code == "too-large" and "more than 0.05 s of processor time" in error.message
    assert error.span is not None and error.span.source.path == str(slow)
    assert results.reports[fine].ok and signal.getitimer(signal.ITIMER_PROF)[0] == 0
