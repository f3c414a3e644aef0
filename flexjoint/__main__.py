"""`python -m flexjoint`: the command line."""

from __future__ import annotations

from flexjoint.cli.main import command

if __name__ == "__main__":
    command()
