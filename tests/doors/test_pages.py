"""Every command line of README, tutorials and how-tos, as printed, from an empty folder, unreduced."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from flysid.cli.output import ExitCode
from tests.doors import tally
from tests.doors.advice import commands_in
from tests.doors.inputs import MissingError
from tests.doors.links import fitting_has_begun
from tests.doors.pages import PAGES, Line, answers_of, check_answer, lines_of, place_of, read, scripts_of
from tests.doors.reader import Reader
from tests.doors.scenes import ALL, INTERRUPTED, LONG, LONG_LINES, NOT_TYPED, SCENES, Scene

EMPTY = Scene()
TUTORIALS = "docs/tutorials/"


@pytest.mark.parametrize("page", PAGES)
def test_the_lines_of_a_page_run_as_printed(
    page: str, tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    if page in LONG and ALL not in os.environ:
        pytest.skip(f"{LONG[page]} s of CPU: make soak types it")
    reader = Reader(tmp_path / "here")
    reader.folder.mkdir()
    scene = SCENES.get(page, EMPTY)
    missing: list[str] = []
    try:
        if page.startswith(TUTORIALS):
            for script in scripts_of(page):
                (tmp_path / "script.py").write_text(script, "utf-8")
                reader.prepare("python ../script.py")
        for line in [Line(""), *lines_of(page)]:
            try:
                _type(line, page, scene, reader)
            except MissingError as error:
                missing.append(f"{line.text or 'all'}: {error}")
                if not line.text:
                    break
    finally:
        reader.ending.close()
        record_property(tally.PROPERTY, reader.cpu_s)
    if missing:
        pytest.skip(f"run but for {'; '.join(missing)}")


def _type(line: Line, page: str, scene: Scene, reader: Reader) -> None:
    """One line, after what it needs; "" is what the page needs."""
    if line.command in LONG_LINES.get(page, ()) and ALL not in os.environ:
        return
    if line.command in scene.before:
        scene.before[line.command](reader)
    if not line.text or line.command in NOT_TYPED.get(page, {}):
        return
    drive = scene.drives.get(line.command, Reader.run)
    done = drive(reader, line.text)
    assert done.returncode == scene.codes.get(line.command, 0), f"{line.text}\n{done.stdout}{done.stderr}"
    assert "Traceback" not in done.stderr, done.stderr
    shown = done.stdout.splitlines()
    check_answer(line, shown)
    typed = {one.command for one in lines_of(page)}
    for command in commands_in(f"{done.stdout}\n{done.stderr}"):
        if command not in typed:
            _follow(command, line, reader)
    if line.command in scene.shown:
        block = answers_of(page)[scene.shown[line.command]]
        everything = [*shown, *done.stderr.splitlines()]
        assert place_of(block, everything) is not None, "\n".join([line.text, *everything])


def _follow(command: str, line: Line, reader: Reader) -> None:
    """What a line advises, and the page does not type, runs as printed: in a copy of the folder.

    A fit until it fits: pages type whole ones. `make soak` waits for the end.
    """
    copy = reader.beside("copy")
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(reader.folder, copy, symlinks=True)
    other = Reader(copy, reader.more | {"FLYSID_FIT_PROGRESS": "json"})
    if command.startswith("flysid fit ") and ALL not in os.environ:
        done = other.run_while(command, fitting_has_begun)
    else:
        done = other.run(command)
    reader.cpu_s += other.cpu_s
    told = f"{line.text}\nadvises: {command}\n{done.stdout}{done.stderr}"
    assert done.returncode in (0, ExitCode.LOSSES, INTERRUPTED), told


@pytest.mark.parametrize("page", PAGES)
def test_no_line_of_a_page_is_overlooked(page: str) -> None:
    shown = [line for line in read(page).splitlines() if line.startswith("$ ")]
    assert len(lines_of(page)) >= len(shown)
    assert {f"$ {line.text}" for line in lines_of(page)} >= set(shown)


def test_scenes_are_of_lines_that_are_on_a_page() -> None:
    named = [(page, scene.names()) for page, scene in SCENES.items()]
    named += [(page, set(lines)) for page, lines in (*NOT_TYPED.items(), *LONG_LINES.items())]
    assert {*LONG, *(page for page, _ in named)} <= set(PAGES)
    for page, names in named:
        assert names <= {line.command for line in lines_of(page)}, page
