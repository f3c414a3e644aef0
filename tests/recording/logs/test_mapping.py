"""The mapping of a log: what may stand in it, and what is said of what may not."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.pages import DOCS, blocks

from flexjoint.core.errors import FlexJointError, RecordingError
from flexjoint.recording.logs import mapping
from flexjoint.recording.logs.mapping import ChannelEntry, MappingFile
from flexjoint.recording.logs.units import UNITS_OF

MULTIPLIED = b"rename: {a: &a [x,x,x,x,x,x,x,x,x], " + b", ".join(
    b"%c: &%c [%s]" % (new, new, b",".join([b"*%c" % old] * 9))
    for old, new in zip(b"abcdefgh", b"bcdefghi", strict=True)
)
MULTIPLIED += b"}\njoints: [*i]"  # 9^9 values in 300 bytes, which a message would print


@pytest.mark.parametrize(
    ("raw", "said"),
    [
        ([1], "expected a mapping with `channels`, got list"),
        ({"chanels": {}}, r"unknown key 'chanels' \(did you mean 'channels'\?\); valid: angles, channels, "),
        ({"channels": {"position": "x"}}, "channels: unknown channel 'position'"),
        ({"channels": {"q": {"form": "x"}}}, "from is missing"),
        ({"channels": {"q": {"from": "x", "units": 1}}}, "in channels.q: unknown key 'units' .did you mean"),
        ({"channels": {"q": {"from": "x", "unit": "N m"}}}, "channels.q: unknown unit 'N m'; valid: deg, m"),
        ({"channels": {"q": {"from": "x", "gear_ratio": 0}}}, "expected numbers other than 0, got"),
        ({"channels": {"q": {"from": "x", "sign": 2}}}, "expected 1 or -1, got"),
        ({"channels": {"q": {"from": "x", "offset": float("inf")}}}, "expected finite numbers, got"),
        ({"channels": {"q": {"from": "x", "side": "both"}}}, "'link' or 'motor'"),
        ({"joints": ["a", "a"]}, "joints: a joint stands twice"),
        ({"time": "t", "rate": 100.0}, "both time and rate"),
        ({"angles": "degrees"}, "angles: Input should be 'rad', 'deg' or 'rev', got 'degrees'"),
    ],
)  # fmt: skip
def test_a_wrong_mapping_is_refused_with_what_is_valid(raw: Any, said: str) -> None:
    with pytest.raises(FlexJointError, match=said) as error:
        mapping.parse(raw)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "does not exist; docs/reference/formats.md has an example"),
        (b"\xff\xfe\x00", "cannot be read as text"),
        (b"channels: [", "is not valid YAML"),
        (b"", "expected a mapping with `channels`, got NoneType"),
        (b"joints: &a [*a]", r"alias \*a stands within what it names"),
        (MULTIPLIED, "more than 20000 values, aliases counted as what they stand for"),
        (b"joints: " + b"[" * 5000, "more than 30 levels of nesting"),
        (b"rate: 100\nrate: 200", "key 'rate' stands twice in line 2"),
        (b"x" * 1_000_001, "has more than 1000000 bytes"),
    ],
    ids=range(9),
)
def test_an_unreadable_mapping_is_refused(tmp_path: Path, text: bytes | None, said: str) -> None:
    path = tmp_path / "map.yaml"
    if text is not None:
        path.write_bytes(text)
    with pytest.raises(RecordingError, match=said) as error:
        mapping.read(path)
    assert "\n" not in str(error.value)


def test_the_mapping_of_the_page_is_one_and_the_page_names_every_key(tmp_path: Path) -> None:
    page = DOCS / "reference" / "formats.md"
    example, *_ = blocks(page, "yaml")  # the others are robots
    (tmp_path / "map.yaml").write_text(example)
    assert mapping.read(tmp_path / "map.yaml").channels
    text = page.read_text(encoding="utf-8")
    keys = [*MappingFile.model_fields, *(f.alias or n for n, f in ChannelEntry.model_fields.items())]
    listed = [*keys, *(unit for units in UNITS_OF.values() for unit in units)]
    assert [key for key in listed if f"`{key}`" not in text] == []


def test_a_short_form_is_the_signal_alone() -> None:
    short = mapping.parse({"channels": {"q": "actual_q", "tau_motor": ["t1", "t2"]}})
    assert short.channels["q"].source == "actual_q" and short.channels["tau_motor"].source == ("t1", "t2")


def test_an_option_may_not_contradict_the_file() -> None:
    file = mapping.parse({"angles": "rad"})
    assert mapping.stated(file, angles="rad", gear_ratio=3.0).gear_ratio == 3.0
    with pytest.raises(RecordingError, match="the mapping states angles: rad, and the command line deg"):
        mapping.stated(file, angles="deg")


# --- anything ---------------------------------------------------------------------------------------------
KEYS = st.sampled_from([*MappingFile.model_fields, *ChannelEntry.model_fields, "from", "q", "tau_motor", "x"])
LEAVES = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | KEYS
ANYTHING = st.recursive(
    LEAVES,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=4),
    max_leaves=12,
)


@settings(max_examples=150, deadline=None)
@given(ANYTHING)
def test_whatever_stands_in_it_a_mapping_is_one_or_is_refused_in_one_line(raw: Any) -> None:
    try:
        assert isinstance(mapping.parse(raw), MappingFile)
    except FlexJointError as error:
        assert "\n" not in str(error) and len(str(error)) < 2000


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=80) | st.text("{}[]:,-!&*|>'\"#\n qaf0.e", max_size=60).map(str.encode))
def test_whatever_bytes_a_mapping_has_it_is_one_or_is_refused(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.yaml"
        path.write_bytes(content)
        try:
            mapping.read(path)
        except FlexJointError as error:
            assert "\n" not in str(error)
