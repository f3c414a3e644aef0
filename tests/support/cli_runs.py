"""Running the command line inside a test."""

from __future__ import annotations

import pytest

from flexjoint.cli.main import UNUSABLE, main


def run(*words: object) -> int:
    try:
        return main([str(word) for word in words])
    except SystemExit as exit:
        return int(exit.code or 0)


def complaint(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """The one line on standard error of a command that cannot use its input."""
    assert run(*words) == UNUSABLE
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("flexjoint: ") and err.endswith("\n") and err.count("\n") == 1
    return err
