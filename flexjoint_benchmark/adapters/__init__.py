"""Other tools on the benchmark: each reads a folder and writes answers, as anybody's tool would.

    python -m flexjoint_benchmark.adapters.least_squares FOLDER ANSWERS.json

They are plain uses of these tools, not the best that somebody who knows them could make of them.
"""
