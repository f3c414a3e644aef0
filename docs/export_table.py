"""Writes the table of exporting.md from the targets' own declarations: `make docs`."""

from __future__ import annotations

from pathlib import Path

from flexjoint.export.targets import page

PAGE = Path(__file__).parent / "reference" / "exporting.md"

if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
