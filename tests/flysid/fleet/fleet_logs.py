"""Small logs of a fleet in a bucket, and the command line in this process."""

from __future__ import annotations

import random

from click.testing import CliRunner, Result

from flysid.cli import root
from flysid.place import Place

ROWS = 60


def table(number: int) -> bytes:
    """A log of its own for every number: a table of a minute."""
    chance = random.Random(number)
    command = [chance.randrange(100) for _ in range(ROWS)]
    lines = (f"{i},{command[i]},{command[i - 1] + chance.randrange(9)}" for i in range(ROWS))
    return ("time_s,command,response\n" + "\n".join(lines) + "\n").encode()


def fill(inbox: str, count: int, vehicles: int = 2) -> list[str]:
    """Put logs into a bucket, a folder a vehicle; their keys."""
    place = Place(inbox)
    keys = [f"v{n % vehicles:03d}/flight{n:02d}.csv" for n in range(count)]
    for n, key in enumerate(keys):
        place.put(key, table(n))
    return keys


def run(*words: object) -> Result:
    """A command line; what FlysidError it ends with is `exception`."""
    return CliRunner().invoke(root, [str(word) for word in words])
