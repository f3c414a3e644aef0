"""An open benchmark of diagnoses: machines with known defects, and what a tool's answers are worth.

    python -m flexjoint_benchmark make FOLDER
    python -m flexjoint_benchmark score FOLDER ANSWERS.json

It shares no code with flexjoint, whose diagnosis is one of those that it judges, and imports nothing of it.
The generator of recordings lies in tests/planting of a checkout, where the tests need it, and in the package,
as flexjoint_benchmark/planting, of an installed wheel.
"""

from pathlib import Path

_HERE = Path(__file__).parent
if not (_HERE / "planting").is_dir():
    __path__.append(str(_HERE.parent / "tests"))

SCHEMA = 1  # of cases.json, of the sealed truth and of answers


class BenchmarkError(ValueError):
    """A folder or a file of answers that cannot be used: one line, with what was expected."""
