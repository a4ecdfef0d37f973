"""`python -m soak.fuzz_child FORMAT SECONDS SEED`: fuzzes one reader and prints the outcome as JSON."""

from __future__ import annotations

import importlib
import json
import sys
from dataclasses import asdict

from soak import Budget, instrument


def main() -> None:
    """Count from the first import of a reader on."""
    instrument.install()
    fuzz = importlib.import_module("soak.fuzz_reader").fuzz
    name, seconds, seed = sys.argv[1:]
    sys.stdout.write(json.dumps(asdict(fuzz(name, int(seed), Budget(float(seconds))))) + "\n")


if __name__ == "__main__":
    main()
