"""`flexjoint schema`: the JSON schema of what a command writes."""

from __future__ import annotations

import argparse
import json

from flexjoint.diagnosis.result.schema import names, schema


def run(arguments: argparse.Namespace) -> None:
    """Print the schema, or without a name the names."""
    if arguments.name is None:
        print("\n".join(names()))
    else:
        print(json.dumps(schema(arguments.name), indent=1))
