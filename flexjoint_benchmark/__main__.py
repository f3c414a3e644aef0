"""Make a benchmark and score answers, without flexjoint: python -m flexjoint_benchmark make | score."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from flexjoint_benchmark import BenchmarkError
from flexjoint_benchmark.folder import make
from flexjoint_benchmark.score import score


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m flexjoint_benchmark", description=__doc__)
    commands = parser.add_subparsers(required=True, dest="command")
    making = commands.add_parser("make", help="write recordings, nominal models and the sealed truth")
    making.add_argument("folder", type=Path)
    making.add_argument("--count", type=int, default=10, help="cases of each part, default 10")
    making.add_argument("--seed", type=int, default=1)
    scoring = commands.add_parser("score", help="score a file of answers")
    scoring.add_argument("folder", type=Path)
    scoring.add_argument("answers", type=Path)
    given = parser.parse_args()
    try:
        if given.command == "make":
            print(f"made {make(given.folder, given.count, given.seed)} cases in {given.folder}")
        else:
            print(score(given.folder, given.answers))
    except BenchmarkError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
