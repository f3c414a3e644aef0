"""The cache of compiled libraries: what is loaded is what this user built, whole."""

from __future__ import annotations

import ctypes
import logging
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from flexjoint.simulation.compiled import cache, compiler

SOURCE = '__attribute__((visibility("default"))) int answer(void) { return 42; }\n'
BUILD = f"""
import sys
import time
from dataclasses import replace
from flexjoint.simulation.compiled import cache, compiler
sys.stdin.read(1)  # all start together
print(cache.library({SOURCE!r} + "/* long enough to overlap */\\n" * 20000, compiler.compilers()[0]))
"""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("FLEXJOINT_CACHE", str(tmp_path / "cache"))
    cache.cache_folder.cache_clear()
    return tmp_path / "cache"


@pytest.fixture(autouse=True, scope="module")
def forget() -> object:
    yield
    cache.cache_folder.cache_clear()


def answer(path: Path) -> int:
    return int(ctypes.CDLL(str(path)).answer())


def test_a_library_is_built_once_in_a_folder_closed_to_others(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = compiler.compilers()[0]
    path = cache.library(SOURCE, one)
    assert answer(path) == 42
    assert folder.stat().st_mode & 0o777 == 0o700 and path.stat().st_mode & 0o777 == 0o700
    assert [found.name for found in folder.iterdir()] == [path.name]  # nothing of the build is left
    monkeypatch.setattr(compiler.Compiler, "compile", None)
    assert cache.library(SOURCE, one) == path


def test_the_name_depends_on_source_compiler_and_processor() -> None:
    one = compiler.compilers()[0]
    newer = compiler.Compiler(one.name, one.command, one.identity + "another processor")
    paths = {cache.library(SOURCE, one), cache.library(SOURCE + " ", one), cache.library(SOURCE, newer)}
    assert len(paths) == 3


@pytest.mark.parametrize("planted", ["writable by others", "a link"])
def test_a_file_that_another_could_have_planted_is_built_anew(planted: str, tmp_path: Path) -> None:
    one = compiler.compilers()[0]
    path = cache.library(SOURCE, one)
    evil = cache.library(SOURCE.replace("42", "666"), one)
    content = evil.read_bytes()
    path.unlink()
    if planted == "a link":
        (tmp_path / "evil.so").write_bytes(content)
        path.symlink_to(tmp_path / "evil.so")
    else:
        path.write_bytes(content)
        path.chmod(0o722)
    assert not cache.trusted_file(path)
    assert cache.library(SOURCE, one) == path
    assert not path.is_symlink() and answer(path) == 42


def test_a_file_of_another_user_is_not_trusted(monkeypatch: pytest.MonkeyPatch) -> None:
    path = cache.library(SOURCE, compiler.compilers()[0])
    assert cache.trusted_file(path)
    monkeypatch.setattr(os, "getuid", lambda: path.stat().st_uid + 1)
    assert not cache.trusted_file(path)
    assert "belongs to another user" in cache.unsafe(path.parent)


@pytest.mark.parametrize("mode", [0o777, 0o755, 0o710])
def test_a_folder_open_to_others_is_not_used(
    mode: int, folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder.mkdir()
    folder.chmod(mode)
    with caplog.at_level(logging.WARNING, "flexjoint"):
        path = cache.library(SOURCE, compiler.compilers()[0])
    assert folder not in path.parents and not list(folder.iterdir())
    assert path.parent.stat().st_mode & 0o777 == 0o700
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert "not safe (others have access" in caplog.text


@pytest.mark.parametrize("below", ["a file", "nothing"])
def test_a_folder_that_cannot_be_made_is_one_line(
    below: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").write_text("")
    chosen = tmp_path / "file" / "cache" if below == "a file" else Path("/proc/nothing/cache")
    monkeypatch.setenv("FLEXJOINT_CACHE", str(chosen))
    one = compiler.compilers()[0]
    with caplog.at_level(logging.WARNING, "flexjoint"):
        path = cache.library(SOURCE, one)
    assert answer(path) == 42
    monkeypatch.setattr(compiler.Compiler, "compile", None)
    assert cache.library(SOURCE, one) == path  # kept as long as the process lives
    assert len(caplog.records) == 1
    assert f"{chosen} cannot be made" in caplog.text and "FLEXJOINT_CACHE" in caplog.text


def test_a_folder_that_another_user_could_swap_is_not_used(tmp_path: Path) -> None:
    inner = tmp_path / "open" / "cache"
    inner.mkdir(parents=True, mode=0o700)
    inner.parent.chmod(0o777)
    assert cache.unsafe(inner) == f"others may write in {inner.parent}"
    inner.parent.chmod(0o1777)  # sticky, as /tmp: only owners rename
    assert cache.unsafe(inner) == ""


def test_two_processes_build_at_once(folder: Path) -> None:
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    both = [
        subprocess.Popen(
            [sys.executable, "-c", BUILD], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=env
        )
        for _ in range(2)
    ]
    for process in both:
        assert process.stdin is not None
        process.stdin.write("x")
        process.stdin.flush()
    paths = {process.communicate(timeout=120)[0].strip() for process in both}
    assert [process.returncode for process in both] == [0, 0]
    assert [str(path) for path in folder.iterdir()] == list(paths)
    assert answer(Path(paths.pop())) == 42


def test_the_cache_does_not_grow_for_ever(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    monkeypatch.setattr(cache, "KEPT", 2)
    one = compiler.compilers()[0]
    paths = []
    for k in range(3):
        paths.append(cache.library(SOURCE + " " * k, one))
        os.utime(paths[-1], (1e9 + k, 1e9 + k))
    assert set(folder.glob("*.so")) == set(paths[1:])


@pytest.mark.parametrize("left", [0, 100, 4096, -1])
def test_a_damaged_library_is_built_anew(left: int) -> None:
    """One that was cut would end the process where it is loaded (SIGBUS)."""
    one = compiler.compilers()[0]
    path = cache.library(SOURCE, one)
    content = path.read_bytes()
    path.write_bytes(content[:left])
    assert answer(cache.library(SOURCE, one)) == 42
    assert list(path.parent.iterdir()) == [path] and path.read_bytes() == content


@pytest.mark.parametrize("why", ["read-only", "full", "fails"])
def test_a_cache_that_cannot_be_written_is_done_without(
    why: str, folder: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    cache._say_once.cache_clear()
    there = cache.cache_folder()
    if why == "fails":  # as a file system does that is mounted read-only

        def refuse(*_: object, dir: Path, prefix: str) -> object:
            if Path(dir) == there:
                raise OSError(30, "Read-only file system")
            return made(dir=dir, prefix=prefix)

        made = cache.tempfile.TemporaryDirectory
        monkeypatch.setattr(cache.tempfile, "TemporaryDirectory", refuse)
        cache._temporary.cache_clear()
        kept = made(prefix="flexjoint.")
        monkeypatch.setattr(cache, "_temporary", lambda: kept)
    else:
        usual = cache._unwritable
        monkeypatch.setattr(cache, "_unwritable", lambda place: why if place == there else usual(place))
    with caplog.at_level(logging.WARNING, "flexjoint"):
        paths = [cache.library(SOURCE, compiler.compilers()[0]) for _ in range(2)]
    assert paths[0] == paths[1] and folder not in paths[0].parents and answer(paths[0]) == 42
    assert len(caplog.records) == 1 and "cannot be written" in caplog.text


def test_a_compiler_that_hangs_is_ended_with_what_it_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    mark = tmp_path / "child"
    script = tmp_path / "cc"
    script.write_text(f"#!/bin/sh\nsleep 60 & echo $! > {mark}\nwait\n")
    script.chmod(0o700)
    monkeypatch.setattr(compiler, "COMPILING", replace(compiler.COMPILING, note=0.3, longest=0.6))
    hangs = compiler.Compiler("slowcc", (str(script),), "slow")
    begin = time.monotonic()
    with (
        caplog.at_level(logging.WARNING, "flexjoint"),
        pytest.raises(compiler.CompilerError, match=r"slowcc did not compile a model in 0\.6 s; try another"),
    ):
        cache.library(SOURCE, hangs)
    assert time.monotonic() - begin < 10.0
    assert "slowcc compiles a model; waiting for at most 0.6 s" in caplog.text
    status = Path(f"/proc/{mark.read_text().strip()}/stat")

    def running() -> bool:
        return status.exists() and status.read_text().rpartition(")")[2].split()[0] not in "ZX"

    for _ in range(100):  # what was killed ends when its turn comes on a busy machine
        if not running():
            break
        time.sleep(0.1)
    assert not running()


def test_builds_that_were_killed_are_removed(folder: Path) -> None:
    cache.cache_folder()
    for name, age in (("build.old", 2 * 3600), ("build.new", 0)):
        (folder / name).mkdir()
        (folder / name / "program.c").write_text("")
        os.utime(folder / name, (time.time() - age,) * 2)
    cache.library(SOURCE, compiler.compilers()[0])
    assert not (folder / "build.old").exists() and (folder / "build.new").exists()
