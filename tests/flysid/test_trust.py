"""A folder of logs may be a stranger's: nothing runs, connects or is written by what a file in it says."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.cli import root
from flysid.cli.config import own_file
from flysid.cli.tomllines import lines_of
from flysid.cli.trust import Own, Who, is_declared, who_may_set
from flysid.cli.verbs import VERBS
from tests.command import call, shell

SWITCHES = {
    "--all", "--calm", "--csv", "--events", "--fail", "--feed-forward", "--fields", "--float32", "--ground",
    "--halves", "--judge",
    "--json", "--keep-mishaps", "--kinematics", "--list", "--markdown", "--messages", "--no-refine",
    "--params", "--pool", "--px4-plane", "--quiet", "--rotate", "--suggest", "--table", "--term",
    "--toml", "--track", "--truth", "--ts", "--unstable", "--vehicle", "--verbose",
}  # fmt: skip
NUMBERS = {
    "--aim", "--altitude", "--amplitude", "--arm", "--band", "--batch", "--crossover", "--dt",
    "--duration", "--false-alarms",
    "--fast", "--fleet", "--for", "--full-scale", "--grid", "--horizon", "--limit", "--lowest", "--mass",
    "--more", "--ms", "--noise", "--peak", "--rate", "--rows", "--seconds", "--seed", "--speed",
    "--vehicles", "--wind", "--window", "--zero",
}  # fmt: skip
"""Switches and numbers that change the result alone. A new one goes here, or is declared as `Own`."""


def every_option() -> Iterator[tuple[tuple[str, ...], click.Option]]:
    def below(
        command: click.Command, words: tuple[str, ...]
    ) -> Iterator[tuple[tuple[str, ...], click.Option]]:
        if isinstance(command, click.Group):
            context = click.Context(command)
            for name in command.list_commands(context):
                found = command.get_command(context, name)
                assert found is not None
                yield from below(found, (*words, name))
        elif words:
            yield from ((words, option) for option in command.params if isinstance(option, click.Option))

    yield from below(root, ())


def long_name(option: click.Option) -> str:
    return max(option.opts, key=len)


@pytest.fixture(autouse=True)
def own_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    home = tmp_path / "config"
    monkeypatch.setenv("XDG_CONFIG_HOME", str(home))
    (home / "flysid").mkdir(parents=True)
    return home / "flysid" / "flysid.toml"


def test_every_option_says_who_may_set_it() -> None:
    for words, option in every_option():
        name = long_name(option)
        assert is_declared(option), f"flysid {' '.join(words)} {name}: say Setting, ProjectFile or Own"
        if who_may_set(option) is not Who.PROJECT or isinstance(option.type, click.Choice):
            continue
        if option.is_flag:
            assert name in SWITCHES, f"{words} {name}: what else does it do?"
        elif not isinstance(option.type, click.types.StringParamType):
            assert name in NUMBERS, f"{words} {name}: what else does it do?"


def test_a_new_option_that_takes_a_text_a_path_or_an_address_is_refused_by_default() -> None:
    from flysid.cli.addresses import SOURCE

    for new in (
        click.Option(["--new"]),
        click.Option(["--new"], multiple=True),
        click.Option(["--new"], default="text"),
        click.Option(["--new"], type=click.Path()),
        click.Option(["--new"], type=click.File()),
        click.Option(["--new"], type=SOURCE),
        Own(["--new"], is_flag=True),
    ):
        assert who_may_set(new) is Who.USER


class Listener:
    """A port that counts who comes."""

    def __init__(self) -> None:
        self._tcp = socket.create_server(("127.0.0.1", 0))
        self.port = self._tcp.getsockname()[1]
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._udp.bind(("127.0.0.1", self.port))
        self._tcp.settimeout(0.0)
        self._udp.settimeout(0.0)

    def has_visitor(self) -> bool:
        for ask in (self._tcp.accept, lambda: self._udp.recvfrom(1)):
            try:
                ask()
            except BlockingIOError:
                continue
            return True
        return False

    def close(self) -> None:
        self._tcp.close()
        self._udp.close()


@pytest.fixture
def listener() -> Iterator[Listener]:
    made = Listener()
    yield made
    made.close()


def hostile(option: click.Option, place: Path, port: int) -> Any:
    """What a stranger would have an option do."""
    name = long_name(option)
    outside = str(place / f"written{name}")
    by_name: dict[str, Any] = {
        "--exec": f"touch {place}/ran",
        "--with": ["channel/x=evilmod:sim"],
        "--cluster": f"tcp://127.0.0.1:{port}",
        "--live": f"udp:127.0.0.1:{port}",
        "--models": "structured:/etc/passwd",
        "--recipe": "../outside.toml",
        "--old": "/etc/passwd",
        "--max-memory": "none",
        "--max-time": "none",
        "--data": f"http://127.0.0.1:{port}/lake",
        "--sql": f"copy (select 1) to '{outside}'",
        "--vehicle-in": "(a+)+$",
        "--unsigned": "keep",
    }
    if name in by_name:
        return by_name[name]
    if option.is_flag:
        return True
    if isinstance(option.type, click.types.IntParamType | click.types.FloatParamType):
        return 1
    return outside


def lines_for(option: click.Option) -> str:
    return long_name(option).lstrip("-")


def arguments_of(words: tuple[str, ...], log: Path, run: Path) -> list[str]:
    """What the verb must be given, harmless."""
    command: click.Command = root
    for word in words:
        assert isinstance(command, click.Group)
        found = command.get_command(click.Context(command), word)
        assert found is not None
        command = found
    given = {"run": run, "run_a": run, "run_b": run, "design": run, "message": "IMU", "paper": "ardrone-ts"}
    needed = [p for p in command.params if isinstance(p, click.Argument) and p.required]
    return [str(given.get(str(p.name), log)) for p in needed]


VERBS_WITH_OPTIONS = sorted({words for words, _ in every_option()})


@pytest.mark.parametrize("words", VERBS_WITH_OPTIONS, ids=" ".join)
def test_a_hostile_project_is_refused_by_name_and_line(
    words: tuple[str, ...], tmp_path: Path, listener: Listener
) -> None:
    place = tmp_path / "place"
    folder = tmp_path / "strangers"
    folder.mkdir()
    place.mkdir()
    (folder / "evilmod.py").write_text(f"open({str(place / 'imported')!r}, 'w')\n")
    (tmp_path / "outside.toml").write_text("")
    log = folder / "flight.csv"
    log.write_text("time,x\n0,1\n1,2\n")
    options = [option for at, option in every_option() if at == words]
    dangerous = [option for option in options if who_may_set(option) is not Who.PROJECT]
    table: dict[str, Any] = {lines_for(o): hostile(o, place, listener.port) for o in options}
    document: dict[str, Any] = table
    for word in reversed(words):
        document = {word: document}
    text = "# a comment\n\n" + tomli_w.dumps(document)
    (folder / "flysid.toml").write_text(text)
    before = sorted(tmp_path.rglob("*"))

    done = call(*words, *arguments_of(words, log, folder), cwd=folder)

    if dangerous:
        assert done.returncode == 2
        assert "the working folder may not set" in done.stderr
    lines = text.splitlines()
    for option in dangerous:
        key = lines_for(option)
        line = next(n for n, content in enumerate(lines, start=1) if content.startswith(f"{key} = "))
        assert f"{key} (flysid.toml:{line})" in done.stderr
    assert not list(place.iterdir())
    assert sorted(tmp_path.rglob("*")) == before
    assert not listener.has_visitor()


def test_what_is_refused_to_the_project_is_the_users(tmp_path: Path, own_home: Path) -> None:
    text = '[synth]\nduration = 5\noutput = "logs"\nformat = "navdata"\n'
    (tmp_path / "flysid.toml").write_text(text)
    refused = call("synth", "-q", cwd=tmp_path)
    assert refused.returncode == 2
    assert "output (flysid.toml:3)" in refused.stderr
    assert str(own_home) in refused.stderr
    (tmp_path / "flysid.toml").write_text(text.replace('output = "logs"\n', ""))
    own_home.write_text('[synth]\noutput = "logs"\nduration = 500\n')
    done = call("synth", "-q", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    told = call("doctor", "logs", "--json", cwd=tmp_path).stdout
    assert json.loads(told)["logs"][0]["duration_s"] < 10.0  # of both files the project's wins


def test_the_users_own_file_is_no_project_where_it_lies(own_home: Path) -> None:
    own_home.write_text('[synth]\noutput = "logs"\nduration = 5\nformat = "navdata"\n')
    assert call("synth", "-q", cwd=own_home.parent).returncode == 0


def test_a_relative_home_of_settings_is_void(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    for said in ("", ".", "config"):
        assert own_file({"XDG_CONFIG_HOME": said}) == tmp_path / ".config" / "flysid" / "flysid.toml"


def test_verbs_of_fleet_have_tables_of_their_own(tmp_path: Path) -> None:
    (tmp_path / "flysid.toml").write_text('[fleet.fit]\nby = "month"\n\n[fleet.ls]\nsql = "select 1"\n')
    assert "fleet ls" in call("fleet", "ls", "s3://b/lake", cwd=tmp_path).stderr
    (tmp_path / "flysid.toml").write_text('[fleet.fti]\nby = "month"\n')
    done = call("fleet", "fit", "lake", cwd=tmp_path)
    assert (done.returncode, "did you mean 'fit'?" in done.stderr) == (2, True)


@pytest.mark.parametrize("link", ["/dev/zero", "pipe"])
def test_settings_that_are_no_file_end_the_command_at_once(tmp_path: Path, link: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "flysid.toml").symlink_to(link)
    done = call("recipes", cwd=tmp_path)
    assert done.returncode == 2
    assert "the settings cannot be read" in done.stderr


@pytest.mark.parametrize(
    "inner", ["mine.toml", "recipes/mine.toml", "px4-rates", "line,structured:plan.toml"]
)
def test_recipes_and_plans_of_the_project_may_be_named(tmp_path: Path, inner: str) -> None:
    key = "models" if "," in inner else "recipe"
    (tmp_path / "flysid.toml").write_text(f'[fit]\n{key} = "{inner}"\n')
    assert "may not set" not in call("fit", "nothing.tlog", "-o", "run", cwd=tmp_path).stderr


@pytest.mark.parametrize(
    "outer",
    [
        "/etc/passwd",
        "../x.toml",
        "a/../../x.toml",
        "link.toml",
        "pipe.toml",
        "s3://b/x.toml",
        "C:/x.toml",
        "~/x.toml",
    ],
)
def test_recipes_and_plans_elsewhere_may_not(tmp_path: Path, outer: str) -> None:
    (tmp_path / "link.toml").symlink_to("/etc/passwd")
    os.mkfifo(tmp_path / "pipe.toml")
    for key, value in (("recipe", outer), ("models", f"line,structured:{outer}")):
        (tmp_path / "flysid.toml").write_text(f'[fit]\n{key} = "{value}"\n')
        done = call("fit", "nothing.tlog", "-o", "run", cwd=tmp_path)
        assert done.returncode == 2
        assert f"{key} (flysid.toml:2)" in done.stderr


def test_lines_of_every_way_to_write_a_key() -> None:
    text = '''# [watch]
a.exec = "x"
[ "watch" ]
note = """
exec = 1
[fit]
"""
exec = "touch x" # ] }
list = [
  "[",  # [
  ']',
]
'data' = \'\'\'
x\'\'\'

[x.y]
z = { one = 1, two = { three = "}" } }
'''
    found = lines_of(text)
    assert found["a", "exec"] == 2
    assert found["watch", "note"] == 4
    assert found["watch", "exec"] == 8
    assert found["watch", "list"] == 9
    assert found["watch", "data"] == 13
    assert found["x", "y"] == 16
    assert found["x", "y", "z", "two", "three"] == 17
    assert ("fit",) not in found


KEYS = st.text("ab\"'#[]{}=\n \\,.", min_size=1, max_size=9)
VALUES = st.recursive(
    st.text("a\"'#[]{}=\n \\,") | st.integers(0, 9) | st.booleans(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=3),
)


@settings(deadline=None)
@given(st.dictionaries(KEYS, st.dictionaries(KEYS, VALUES, max_size=4), max_size=3), st.booleans())
def test_the_line_of_a_key_is_where_it_begins(document: dict[str, Any], multiline: bool) -> None:
    text = tomli_w.dumps(document, multiline_strings=multiline)
    found = lines_of(text)
    for verb, table in document.items():
        for key in table:
            above = tomllib.loads("".join(text.splitlines(keepends=True)[: found[verb, key] - 1]))
            assert key not in above.get(verb, {})


HIJACKED = ("threading", "selectors", "socket", "struct", "signal", "json", "click", "numpy")


def test_modules_beside_the_logs_are_not_imported(tmp_path: Path) -> None:
    folder = tmp_path / "strangers"
    folder.mkdir()
    for name in HIJACKED:
        (folder / f"{name}.py").write_text(f"open({str(tmp_path / name)!r}, 'w')\nraise SystemExit(9)\n")
    (folder / "flight.csv").write_text("time,x\n" + "".join(f"{k / 50},{k % 7}\n" for k in range(200)))
    script = Path(sys.executable).with_name("flysid")
    done = subprocess.run(
        [script, "ingest", "flight.csv", "-o", "../data", "-q"],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert not [name for name in HIJACKED if (tmp_path / name).exists()]


def test_a_cache_that_numba_is_sent_to_is_refused(tmp_path: Path) -> None:
    (tmp_path / ".numba_config.yaml").write_text("cache_dir: ./cache\n")
    done = call("recipes", cwd=tmp_path)
    assert done.returncode == 2
    assert ".numba_config.yaml" in done.stderr


def test_a_style_beside_the_logs_is_ignored(tmp_path: Path) -> None:
    program = tmp_path / "bin" / "latex"
    program.parent.mkdir()
    program.write_text(f"#!/bin/sh\ntouch {tmp_path}/ran\nexit 1\n")
    program.chmod(0o755)
    folder = tmp_path / "strangers"
    folder.mkdir()
    (folder / "matplotlibrc").write_text("text.usetex: True\nbackend: module://evilmod\n")
    (folder / "flight.csv").write_text("time,x\n" + "".join(f"{k / 50},{k % 7}\n" for k in range(200)))
    done = shell(
        "plot", "flight.csv", "x", "-o", "../x.svg", cwd=folder, PATH=f"{program.parent}:/usr/bin:/bin"
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "x.svg").is_file()
    assert not (tmp_path / "ran").exists()


def test_every_verb_was_tried() -> None:
    assert {words[0] for words in VERBS_WITH_OPTIONS} == set(VERBS)
