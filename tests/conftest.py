"""Fixtures of the tests of the command line, and a cache of compiled libraries for tests alone."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from support import fake_diagnosis

from flexjoint.core.ops import Value
from flexjoint.core.running.worker_pool import WORKERS
from flexjoint.model.dynamics import State
from flexjoint.recording import table as recording
from flexjoint.robot.robot import Robot
from flexjoint.simulation.compiled import cache
from flexjoint.simulation.schemes.midpoint import Midpoint

if "PYTEST_XDIST_WORKER" in os.environ:  # the cores are taken by the tests beside each other
    os.environ.setdefault(WORKERS, "1")


@pytest.fixture
def arm(tmp_path: Path) -> Robot:
    """A robot of two joints, its YAML and URDF in the test's folder."""
    return fake_diagnosis.arm(tmp_path)


@pytest.fixture
def monday(tmp_path: Path) -> Path:
    """A good recording of that robot."""
    path = tmp_path / "monday.csv"
    recording.write(fake_diagnosis.signals(seconds=4.0), path)
    return path


@pytest.fixture
def one_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    """The default scheme on numbers takes one pass a step, as on expressions."""

    def step(self: Midpoint, x: State, tau_m: Value) -> State:
        return self.one_pass(x, tau_m, x.v, x.v + self.a * x.acc).end

    monkeypatch.setattr(Midpoint, "step", step)


@pytest.fixture(scope="module")
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """An empty cache, so that a module compiles what it runs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FLEXJOINT_CACHE", str(tmp_path_factory.mktemp("cache")))
        cache.cache_folder.cache_clear()
        yield
    cache.cache_folder.cache_clear()
