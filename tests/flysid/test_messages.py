"""What messages say: the commands that they suggest exist, and wrong input is told in a user's words."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from click.testing import CliRunner

import flysid
from flysid.cli import root
from flysid.errors import FlysidError, FormatError, WriteError
from flysid.files import writing_to
from flysid.ingest.align.align import _too_short
from flysid.ingest.align.recipe import load_recipe
from flysid.ingest.align.report import AlignReport, FlightReport
from flysid.store import create_data_folder
from flysid.validate.runs.fitone import nothing_done

SOURCES = Path(__file__).parents[2]
OF_OTHERS = {"--upgrade", "--nthreads", "--no-nanny", "--help", "--raw"}
"""Options of pip, of Dask's programs and of InfluxDB, and the one that every verb has."""
NAMED = re.compile(r"(?<![\w-])--[a-z][a-z0-9-]*")
COMMAND = re.compile(r"flysid ((?:fleet )?[a-z]+)((?: +[^\s;:,']+)*)")


@cache
def messages() -> tuple[tuple[str, str], ...]:
    """Place and text of the program's strings that name a command or an option; what is filled in is an X."""
    found: list[tuple[str, str]] = []
    for package in ("flysid", "ingest", "model", "validate"):
        for file in sorted((SOURCES / package).rglob("*.py")):
            source = file.read_text()
            if NAMED.search(source):
                found += (
                    (f"{file.relative_to(SOURCES)}:{line}", text) for line, text in _texts(ast.parse(source))
                )
    return tuple(found)


def _texts(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and text of every string but docstrings."""
    nodes = list(ast.walk(tree))
    dull = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    dull |= {id(part) for node in nodes if isinstance(node, ast.JoinedStr) for part in node.values}
    for node in nodes:
        if isinstance(node, ast.JoinedStr | ast.Constant) and id(node) not in dull:
            yield node.lineno, _text(node)


def _text(node: ast.AST) -> str:
    if isinstance(node, ast.JoinedStr):
        return "".join(_text(part) or "X" for part in node.values)
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


@cache
def options_of(words: str) -> frozenset[str]:
    """The options of a verb, or of a verb of `fleet`; empty where there is no such verb."""
    command: click.Command | None = root
    for word in words.split():
        if isinstance(command, click.Group):
            command = command.get_command(click.Context(command), word)
    if command is None or command is root:
        return frozenset()
    return frozenset(name for option in command.params for name in (*option.opts, *option.secondary_opts))


def options_of_all() -> frozenset[str]:
    fleet = root.get_command(click.Context(root), "fleet")
    assert isinstance(fleet, click.Group)
    verbs = [
        *root.list_commands(click.Context(root)),
        *(f"fleet {v}" for v in fleet.list_commands(click.Context(fleet))),
    ]
    return frozenset[str]().union(*map(options_of, verbs))


def test_commands_that_messages_suggest_can_be_typed() -> None:
    wrong = []
    for place, text in messages():
        for verb, words in COMMAND.findall(text):
            options = [word for word in words.split() if re.fullmatch("-[A-Za-z]|--[a-z][a-z0-9-]*", word)]
            if options and (strange := set(options) - options_of(verb)):
                wrong.append(f"{place}: flysid {verb}{words}: {', '.join(strange)}")
    assert not wrong, "\n".join(wrong)


def test_options_that_messages_name_exist() -> None:
    known = options_of_all() | OF_OTHERS
    wrong = [
        f"{place}: {word}"
        for place, text in messages()
        if " " in text
        for word in NAMED.findall(text)
        if word not in known
    ]
    assert not wrong, "\n".join(wrong)


N = 300
U = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, N // 20), 20)
Y = np.convolve(U, 0.2 * 0.9 ** np.arange(N))[:N]


def data(u: object = U, y: object = Y, **names: list[str]) -> flysid.Dataset:
    return flysid.Dataset.from_arrays(u, y, dt_s=0.05, **names)  # type: ignore[arg-type]


def arx(**settings: object) -> Any:
    return flysid.ARX(refine=False, **({"na": 1, "nb": 1, "nk": 1} | settings)).fit(data())  # type: ignore[arg-type]


SAID: list[tuple[Callable[[], object], str]] = [
    (lambda: data([U], [Y, Y]), "u has 1 segment and y has 2"),
    (lambda: data(inputs=["a", "b"]), "2 names for 1 signal"),
    (
        lambda: data([U, np.c_[U, U]], [Y, Y]),
        "a segment has 2 inputs and 1 output; the dataset has 1 input and 1 output",
    ),
    (
        lambda: data(U[:12], Y[:12]).split(by="time"),
        "too little data to hold out 30 % by time: 12 samples, 0.6 s, in 1 segment Try: add flights",
    ),
    (lambda: arx(na=-1), 'ARX: na is a whole number from 0 on or "auto", not -1.'),
    (lambda: arx(nb=(1, 2)), "nb has 2 numbers for 1 input"),
    (lambda: arx(nk_hint=(1, 2)), "nk_hint=(1, 2) Try: give () or 1 whole number, one per input"),
    (lambda: arx(nk=500), "no segment is longer than the 500 samples that the model looks back on"),
    (lambda: arx(na=200), "300 samples are too few for 202 coefficients per output"),
    (lambda: flysid.TS(na=200).fit(data()), "300 samples are too few for 402 coefficients per output"),
    (lambda: flysid.StateSpace(past=200).fit(data()), "choose smaller orders, delays or a shorter past"),
    (
        lambda: flysid.TS().fit(data(np.zeros((N, 0)))),
        "the dataset has no input Try: name an input in the recipe",
    ),
    (lambda: flysid.StaticTS().fit(data(np.zeros((N, 0)))), "the dataset has no input"),
    (lambda: flysid.ANFIS().fit(data(np.zeros((N, 0)))), "the dataset has no input"),
    (lambda: flysid.TS().fit(data(np.ones(N))), "input 'u' never changes: nothing can be learnt from it"),
    (lambda: flysid.StaticTS(rules=500).fit(data()), "500 rules asked for, but the data hold"),
    (lambda: flysid.TF(poles=-1).fit(data()), 'TF: poles is a whole number from 0 on or "auto", not -1.'),
    (
        lambda: flysid.TF(poles=1, band=(1000.0, 2000.0)).fit(data()),
        "fewer than three frequencies were measured from 1e+03 to 2e+03 rad/s",
    ),
    (
        lambda: flysid.measure_response(data(), band=(1e4, 1e5)),
        "no frequency between 1e+04 and 1e+05 rad/s can be measured",
    ),
    (lambda: arx().simulate(U, []), "a simulation starts from 1 measured output, not 0"),
    (lambda: arx().simulate(np.c_[U, U], [0.0]), "u must have 1 column, not shape (300, 2)"),
    (
        lambda: flysid.compare([arx()], data(inputs=["a"])),
        "model 'arx' has the inputs u, the data a Try: compare on data of the recipe that it was fitted with",
    ),
    (lambda: flysid.read("absent.csv"), "no such file (absent.csv) Try: check its name and folder"),
    (lambda: flysid.read("."), "a folder, not a log (.) Try: flysid ingest . -o DATA reads all its logs"),
    (lambda: create_data_folder(__file__), "a file, not a folder"),
    (lambda: flysid.open("ftp://x/y"), "not an address of an object store"),
    (lambda: flysid.open("a/b"), "make it with: flysid ingest LOG... -o a/b"),
]


@pytest.mark.parametrize(("act", "words"), SAID, ids=[words[:40] for _, words in SAID])
def test_wrong_input_is_told_in_words(act: Callable[[], object], words: str) -> None:
    with pytest.raises(FlysidError, match=re.escape(words)):
        act()


FILES = [
    (
        "a.tlog",
        b"hello world\n" * 100,
        "text, where MAVLink telemetry (.tlog, raw, pcap) is expected: its first line is 'hello world'",
    ),
    ("a.csv", b"t,u,y\n", "one line of text: 't,u,y'"),
    ("a.bin", bytes(5000), "nothing but zeros (a.bin, byte 0) Try: copy it from the vehicle again"),
    (
        "a.ulg",
        b"ULog\x01\x12",
        "not a ULog: the header is missing or cut (a.ulg, byte 0) Try: check that the download",
    ),
]


@pytest.mark.parametrize(("name", "content", "words"), FILES, ids=[name for name, *_ in FILES])
def test_what_is_no_log_is_told_in_words(name: str, content: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FlysidError, match=re.escape(words)):
        flysid.read(tmp_path / name)


RECIPE = """
name = "mine"
[signals.u]
unit = "deg"
sources = [{ stream = "table", field = "u", unit = "deg" }]
[channels.main]
inputs = ["u"]
outputs = ["u"]
"""
RECIPES = [
    ("", "'name' is missing"),
    (RECIPE.replace('outputs = ["u"]', ""), "'outputs' is missing in [channels.NAME]"),
    (RECIPE.replace('["u"]', '"u"'), "channels.NAME.inputs must be a list, not text"),
    (
        RECIPE.replace('unit = "deg" }', 'unit = "deg", lag_s = "x" }'),
        "signals.NAME.sources[0].lag_s must be a number, not text",
    ),
    (RECIPE.replace('unit = "deg" }', 'unit = "furlong" }'), "unknown unit 'furlong' of 'u'"),
    (
        RECIPE.replace("[signals.u]", '[signals.u]\nhold = "maybe"'),
        "wrong value: Invalid enum value 'maybe' in [signals.NAME.hold]",
    ),
]


@pytest.mark.parametrize(("text", "words"), RECIPES, ids=[words for _, words in RECIPES])
def test_a_wrong_recipe_is_told_in_tomls_words(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "r.toml").write_text(text)
    with pytest.raises(FlysidError, match=re.escape(words)):
        load_recipe(tmp_path / "r.toml")


DAMAGED = [
    ("dt_s", None, "a value is not of the type that it should be"),
    ("dt_s", -1.0, "damaged model file: a sample time of -1.0 s"),
    ("a", ..., "damaged model file: it has no 'a'"),
    ("structure", "new", "unknown model structure 'new'"),
]


@pytest.mark.parametrize(("key", "value", "words"), DAMAGED, ids=[words for *_, words in DAMAGED])
def test_a_damaged_model_is_told_without_pythons_words(
    key: str, value: object, words: str, tmp_path: Path
) -> None:
    file = tmp_path / "m.json"
    arx().save(file)
    document = {
        k: value if k == key else v
        for k, v in json.loads(file.read_text()).items()
        if (k, value) != (key, ...)
    }
    file.write_text(json.dumps(document))
    with pytest.raises(FlysidError, match=re.escape(words)):
        flysid.load(file)


@pytest.mark.parametrize(
    ("never", "advice"),
    [
        ("mode AUTO never holds: the log states no modes", "leave out --mode or --between"),
        ("condition 'armed' never holds", "remove the condition"),
    ],
)
def test_what_never_holds_is_blamed_on_the_option_or_on_the_recipe(never: str, advice: str) -> None:
    report = AlignReport("quick", "y", 50.0, (FlightReport("f", notes=(never,)),))
    assert advice in _too_short(report, 20).hint


def test_fields_that_cannot_be_fitted_are_not_said_to_be_of_a_recipe() -> None:
    assert nothing_done("quick", "fitted", {"y": "no"}).message == "no channel could be fitted: y: no"


def test_one_log_that_cannot_be_read_is_told_with_its_own_advice(tmp_path: Path) -> None:
    (tmp_path / "empty.tlog").touch()
    told = CliRunner().invoke(root, ["show", str(tmp_path / "empty.tlog")])
    assert isinstance(told.exception, FormatError)
    assert (told.exception.message, told.exception.path) == (
        "the file is empty",
        str(tmp_path / "empty.tlog"),
    )
    assert told.exception.hint == "check that the download or copy finished"


def test_arrows_refusal_to_write_is_told_in_the_systems_words(tmp_path: Path) -> None:
    told = "Error writing bytes to file. Detail: [errno 28] No space left on device"
    with (
        pytest.raises(WriteError, match=r"^cannot be written: No space left on device"),
        writing_to(tmp_path),
    ):
        raise OSError(told)
