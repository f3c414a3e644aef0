"""Run the study, or write its tables; from the checkout:

PYTHONPATH=tests:. python -m study run   --out FOLDER [--shard 1/2] [--jobs 2] [--part single] [--every 10]
PYTHONPATH=tests:. python -m study table --out FOLDER [--page docs/studies/diagnosis_study.md]
PYTHONPATH=tests:. python -m study misses --out FOLDER
PYTHONPATH=tests:. python -m study goals --out FOLDER
PYTHONPATH=tests:. python -m study ablation --out FOLDER [--sample 43] [--page docs/studies/ablation.md]
PYTHONPATH=tests:. python -m study smallest [--table docs/site/smallest_sizes.json]

The parts dirty, background, unknown and fresh are run when asked for; of the first three the sealed numbers
with --sealed only. What comes out of fresh is counted, and must never lead to a rule.
"""

import argparse
from pathlib import Path

from . import ablation
from .cases import COUNTS, USUAL
from .dirty import goals
from .page import markdown, misses
from .run import records, run
from .smallest import write as write_smallest


def shard(text: str) -> tuple[int, int]:
    index, _, count = text.partition("/")
    if not (index.isdigit() and count.isdigit() and 1 <= int(index) <= int(count)):
        raise argparse.ArgumentTypeError(f"expected i/n with i from 1 to n, e.g. 1/2; got {text!r}")
    return int(index), int(count)


def arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    commands = parser.add_subparsers(required=True, dest="command")
    for name in ("run", "table", "misses", "goals", "ablation"):
        command = commands.add_parser(name)
        command.add_argument("--out", type=Path, required=True, metavar="FOLDER")
        if name == "run":
            command.add_argument("--shard", type=shard, default=(1, 1), metavar="i/n")
            command.add_argument("--jobs", type=int, help="processes, default one a core")
            command.add_argument("--part", nargs="+", choices=list(COUNTS), default=list(USUAL))
            command.add_argument("--every", type=int, default=1, help="only every n-th case of a part")
            command.add_argument(
                "--sealed", action="store_true", help="the sealed numbers of dirty, background and unknown"
            )
        if name == "ablation":
            command.add_argument("--sample", type=int, default=ablation.USUAL_SAMPLE, help="cases, about")
        if name in ("table", "ablation"):
            command.add_argument(
                "--page", type=Path, metavar="PAGE.md", help="write there, not to the screen"
            )
    command = commands.add_parser("smallest")
    command.add_argument("--table", type=Path, default=Path("docs/site/smallest_sizes.json"))
    return parser


def main() -> None:
    parser = arguments()
    given = parser.parse_args()
    if given.command == "smallest":
        write_smallest(given.table)
        return
    try:
        if given.command == "run":
            run(given.out, given.shard, given.jobs, given.part, given.every, given.sealed)
            return
        if given.command == "ablation":
            ablation.run(given.out, given.sample)
    except ValueError as error:
        parser.exit(2, f"study: {error}\n")
    if given.command == "ablation":
        text = ablation.page(ablation.results(given.out))
    else:
        found = records(given.out)
        if not found:
            parser.exit(2, f"study: no results in {given.out}; run the study first\n")
        text = {"misses": misses, "goals": goals}.get(given.command, markdown)(found)
    if given.command in ("table", "ablation") and given.page is not None:
        given.page.write_text(text, encoding="utf-8")
    else:
        print(text, end="")


if __name__ == "__main__":  # worker processes import this module, too
    main()
