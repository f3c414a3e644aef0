"""Write a folder of planted cases; from tests/: python -m planting FOLDER [--seed 1] [--only PREFIX ...]"""

import argparse
from pathlib import Path

from .cases import all_cases, write_case

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("folder", type=Path)
parser.add_argument("--seed", type=int, default=1)
parser.add_argument("--only", nargs="*", help="prefixes of case names")
given = parser.parse_args()
for planned in all_cases(given.seed):
    if not given.only or planned.name.startswith(tuple(given.only)):
        write_case(planned, given.folder)
        print(planned.name)
