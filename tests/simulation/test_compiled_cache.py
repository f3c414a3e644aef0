"""The cache of compiled libraries: what is loaded is what this user built, whole."""

from __future__ import annotations

import ctypes
import logging
import os
import subprocess
import sys
from pathlib import Path

import pytest

from flexjoint.simulation.compiled import cache, compiler

SOURCE = '__attribute__((visibility("default"))) int answer(void) { return 42; }\n'
BUILD = f"""
import sys
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
