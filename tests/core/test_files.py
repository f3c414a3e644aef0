"""Files and folders that appear whole or not at all, alone and together."""

from __future__ import annotations

from pathlib import Path

import pytest

from flexjoint.core.errors import FlexJointError
from flexjoint.core.files import all_or_none, check_folder, whole_folder, write_text


def test_files_written_together_appear_at_the_end(tmp_path: Path) -> None:
    (tmp_path / "b").write_text("old")
    with all_or_none():
        write_text(tmp_path / "a", "first")
        with all_or_none():
            write_text(tmp_path / "b", "new")
        assert not (tmp_path / "a").exists() and (tmp_path / "b").read_text() == "old"
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a": "first", "b": "new"}
    write_text(tmp_path / "a", "alone")  # what comes after them appears at once again
    assert (tmp_path / "a").read_text() == "alone"


def test_where_one_fails_none_appears(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(FlexJointError, match=r"cannot write .*: File exists"), all_or_none():
        write_text(tmp_path / "a", "first")
        write_text(tmp_path / "file" / "b", "second")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("links", [False, True])
def test_where_one_cannot_have_its_name_all_others_are_as_they_were(
    tmp_path: Path, links: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(*_: object, follow_symlinks: bool) -> None:
        raise OSError(95, "Operation not supported")

    if not links:
        monkeypatch.setattr("os.link", none)
    (tmp_path / "old").write_text("as it was")
    with pytest.raises(FlexJointError, match=r"cannot write .*/folder: Is a directory"), all_or_none():
        for name in ("new", "old", "folder", "last"):
            write_text(tmp_path / name, "new")
        (tmp_path / "folder").mkdir()  # meanwhile
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "old"]
    assert (tmp_path / "old").read_text() == "as it was"


@pytest.mark.parametrize("there", [False, True])
def test_a_folder_appears_with_all_that_is_in_it(tmp_path: Path, there: bool) -> None:
    out = tmp_path / "new" / "out"
    if there:
        out.mkdir(parents=True)
    with whole_folder(out) as folder:
        write_text(folder / "case" / "a", "first")
        assert not (out / "case").exists()
    assert (out / "case" / "a").read_text() == "first"
    assert [path.name for path in out.parent.iterdir()] == ["out"]


def test_a_folder_that_fails_leaves_nothing(tmp_path: Path) -> None:
    with (
        pytest.raises(FlexJointError, match=r"cannot write .*out: No space"),
        whole_folder(tmp_path / "out") as f,
    ):
        write_text(f / "a", "first")
        raise OSError(28, "No space left on device")
    assert not list(tmp_path.iterdir())


def test_a_folder_that_holds_something_is_left_alone(tmp_path: Path) -> None:
    write_text(tmp_path / "out" / "a", "mine")
    with pytest.raises(FlexJointError, match="is not empty"), whole_folder(tmp_path / "out"):
        raise AssertionError("no work before it is refused")
    assert (tmp_path / "out" / "a").read_text() == "mine"


def test_a_place_is_tried_whatever_its_rights_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rights do not hold for every user, nor on every disk."""

    def refused(dir: Path) -> None:
        raise PermissionError(13, "Permission denied", str(dir))

    monkeypatch.setattr("tempfile.TemporaryFile", refused)
    with pytest.raises(FlexJointError, match=r"no file can be made in .*; choose another place"):
        check_folder(tmp_path / "a", tmp_path / "new")


def test_a_place_below_a_file_takes_no_file(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    check_folder(tmp_path / "a", tmp_path / "new" / "newer")
    with pytest.raises(FlexJointError, match=r"no file can be made in .*file; choose another place"):
        check_folder(tmp_path / "a", tmp_path / "file" / "new")
