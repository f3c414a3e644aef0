"""A folder or a list says which recordings there are, of whom and when."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest
from support.pages import DOCS, blocks

from flexjoint.core.errors import FlexJointError
from flexjoint.diagnosis.followup.fleet.roster import LIST, read


def moment(*parts: int) -> float:
    return datetime(*parts, tzinfo=UTC).timestamp()  # type: ignore[misc, arg-type]


def test_a_folder_has_one_folder_a_machine(tmp_path: Path) -> None:
    logs = ("b/2026-03-09.csv", "b/run_20260302_0615.parquet", "a/x.csv")
    for name in ("b/arm.yaml", "a/arm.yaml", "c/notes.md", *logs):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    roster = read(tmp_path)
    assert [(e.machine, e.recording.name) for e in roster.entries] == [
        ("a", "x.csv"),
        ("b", "run_20260302_0615.parquet"),
        ("b", "2026-03-09.csv"),
    ]
    assert [e.time for e in roster.entries[1:]] == [moment(2026, 3, 2, 6, 15), moment(2026, 3, 9)]
    assert roster.entries[0].robot == tmp_path / "a" / "arm.yaml"
    (tmp_path / "b" / "other.yaml").touch()
    with pytest.raises(FlexJointError, match=r"expected one robot file .* found 2"):
        read(tmp_path)
    assert {e.robot.name for e in read(tmp_path, Path("all.yaml")).entries} == {"all.yaml"}


def test_a_list_has_times_temperatures_and_repairs(tmp_path: Path) -> None:
    (tmp_path / LIST).write_text(
        "recording,machine,time,temperature,event\n"
        "late.csv,a,2026-03-09T12:00,21.5,\nearly.csv,a,2026-03-02,,\n,a,2026-03-05,,gear replaced\n"
    )
    roster = read(tmp_path, Path("arm.yaml"))
    assert [(e.recording.name, e.temperature) for e in roster.entries] == [
        ("early.csv", None),
        ("late.csv", 21.5),
    ]
    assert [(e.text, e.time) for e in roster.events] == [("gear replaced", moment(2026, 3, 5))]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("recording,machine\na.csv,\n", "line 2: expected a name in the column machine"),
        ("recording,machine\na.csv,a\n", "line 2: expected a robot file in the column robot"),
        ("recording,machine,robot,time\na.csv,a,r.yaml,soon\n", "expected a time such as .* got soon"),
        ("recording,machine,robot,temperature\na.csv,a,r.yaml,warm\n", "expected a temperature"),
        ("recording,machine,colour\na.csv,a,red\n", "unknown column .*colour.*; valid: recording"),
        ("recording,machine\n", "has no recording"),
    ],
)
def test_a_list_that_cannot_be_used_is_refused_with_its_line(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "list.csv"
    path.write_text(text)
    with pytest.raises(FlexJointError, match=said):
        read(path)


def test_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FlexJointError, match="does not exist"):
        read(tmp_path / "none")
    with pytest.raises(FlexJointError, match="has no recording"):
        read(tmp_path)


def test_the_list_of_the_page_is_one(tmp_path: Path) -> None:
    (text,) = blocks(DOCS / "howto" / "fleets.md", "csv")
    (tmp_path / "list.csv").write_text(text)
    roster = read(tmp_path / "list.csv")
    assert [e.temperature for e in roster.entries] == [21.5, 24.0, 22.0]
    assert [e.text for e in roster.events] == ["gear of the elbow replaced"]


def test_a_recording_whose_name_no_disk_takes_is_one_that_is_not_there(tmp_path: Path) -> None:
    (tmp_path / "list.csv").write_text(f"recording,machine\n{'9' * 400}.csv,a\n")
    (entry,) = read(tmp_path / "list.csv", tmp_path / "r.yaml").entries
    assert entry.time == 0.0
