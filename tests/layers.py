"""The floors of every folder, for the import contracts of pyproject.toml.

`python -m tests.layers` writes them anew below the line `MARK`, from the imports as they are. A folder whose
contract is written by hand, above that line, is left out. A change of a floor is then seen in the diff.
"""

from __future__ import annotations

import tomllib
from collections.abc import Collection
from pathlib import Path
from typing import Any

import grimp

PROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"
MARK = "# Floors of all other folders, written by `python -m tests.layers`.\n"


def folders(graph: grimp.ImportGraph) -> list[str]:
    """Packages that hold several modules."""
    return sorted(name for name in graph.modules if len(graph.find_children(name)) > 1)


def covered(contracts: Collection[dict[str, Any]]) -> set[str]:
    """Folders of which every module has a floor."""
    return {name for c in contracts if c.get("exhaustive") for name in c.get("containers", ())}


def contracts_of(text: str) -> list[dict[str, Any]]:
    """The contracts in a project file."""
    found: list[dict[str, Any]] = tomllib.loads(text)["tool"]["importlinter"]["contracts"]
    return found


def floors(graph: grimp.ImportGraph, folder: str) -> list[list[str]]:
    """The modules of a folder, highest floor first; a module stands above all that it imports."""
    rooms = sorted(graph.find_children(folder))
    below = {
        room: [
            other
            for other in rooms
            if other != room and graph.direct_import_exists(importer=room, imported=other, as_packages=True)
        ]
        for room in rooms
    }
    height: dict[str, int] = {}
    while len(height) < len(rooms):
        ready = [r for r in rooms if r not in height and all(other in height for other in below[r])]
        assert ready, f"a circle in {folder}"
        height |= {r: 1 + max((height[other] for other in below[r]), default=-1) for r in ready}
    names = [[r.rpartition(".")[2] for r in rooms if height[r] == h] for h in range(max(height.values()) + 1)]
    return names[::-1]


def contract(graph: grimp.ImportGraph, folder: str) -> str:
    """The contract of a folder as TOML."""
    layers = "".join(f'    "{" : ".join(names)}",\n' for names in floors(graph, folder))
    head = f'[[tool.importlinter.contracts]]\nname = "floors of {folder}"\ntype = "layers"\n'
    return f'{head}containers = ["{folder}"]\nexhaustive = true\nlayers = [\n{layers}]\n'


def renewed(text: str) -> str:
    """A project file with the floors of today."""
    by_hand = text.partition(MARK)[0].rstrip() + "\n"
    graph = grimp.build_graph("flysid")
    known = covered(contracts_of(by_hand))
    written = [contract(graph, folder) for folder in folders(graph) if folder not in known]
    return "\n".join([by_hand, MARK, *written])


if __name__ == "__main__":
    PROJECT.write_text(renewed(PROJECT.read_text("utf-8")), "utf-8")
