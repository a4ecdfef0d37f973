"""Every folder has an import contract that names each of its modules, and the written ones are of today."""

from __future__ import annotations

import grimp
import pytest

from tests import layers


@pytest.fixture(scope="module")
def graph() -> grimp.ImportGraph:
    return grimp.build_graph("flysid")


def test_every_folder_has_an_exhaustive_contract(graph: grimp.ImportGraph) -> None:
    known = layers.covered(layers.contracts_of(layers.PROJECT.read_text("utf-8")))
    assert set(layers.folders(graph)) <= known, "run: python -m tests.layers"


def test_a_contract_that_leaves_modules_out_does_not_count() -> None:
    assert not layers.covered([{"containers": ["flysid.model"]}, {"layers": ["flysid.model.base"]}])


def test_floors_stand_on_what_they_import(graph: grimp.ImportGraph) -> None:
    found = layers.floors(graph, "flysid.model.narx")
    at = {name: height for height, names in enumerate(reversed(found)) for name in names}
    for room in graph.find_children("flysid.model.narx"):
        for other in graph.find_children("flysid.model.narx") - {room}:
            if graph.direct_import_exists(importer=room, imported=other, as_packages=True):
                assert at[room.rpartition(".")[2]] > at[other.rpartition(".")[2]]


def test_a_folder_that_is_new_gets_a_contract() -> None:
    graph = grimp.ImportGraph()
    for name in ("flysid", "flysid.a", "flysid.b"):
        graph.add_module(name)
    graph.add_import(importer="flysid.a", imported="flysid.b")
    assert layers.floors(graph, "flysid") == [["a"], ["b"]]
    assert 'containers = ["flysid"]' in layers.contract(graph, "flysid")


def test_the_folders_of_validate_are_small_and_low(graph: grimp.ImportGraph) -> None:
    found = [name for name in layers.folders(graph) if name.startswith("flysid.validate")]
    assert len(found) >= 7
    assert {name: n for name in found if (n := len(graph.find_children(name))) > 20} == {}
    assert {name: n for name in found if (n := len(layers.floors(graph, name))) > 8} == {}
