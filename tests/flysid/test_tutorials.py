"""The tutorials, as they stand: every command runs, and prints what the page says."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from flysid.cli import root
from tests.command import ROOT
from tests.samplelogs import dataflash_systemid

LOGS = ROOT.parent / "shared/logs"
PAGES = sorted((ROOT / "docs/tutorials").glob("*.md"))
REAL = {
    "dataflash.md": ("flight.bin", LOGS / "dataflash/copter_437s.bin"),
    "blackbox.md": ("flight.bfl", LOGS / "blackbox/hiro_highP_highD.bfl"),
}
SIMULATED = {"systemid.md": ("flight.bin", dataflash_systemid.build)}
RULE = re.compile("-{3,}")
NUMBER = re.compile(r"\d+(?:\.\d+)?")


def blocks(page: Path) -> list[tuple[str, list[str]]]:
    """(command, the lines that it prints) of every console block; three dots leave out the rest."""
    found: list[tuple[str, list[str]]] = []
    for block in re.findall(r"```console\n(.*?)```", page.read_text("utf-8"), re.DOTALL):
        for line in block.splitlines():
            if line.startswith("$ "):
                found.append((line[2:], []))
            else:
                found[-1][1].append(line)
    return found


def alike(shown: str, told: str) -> bool:
    """The same words, and numbers within a tenth: last bits, and so widths, depend on the machine."""
    shown = RULE.sub("---", shown)
    told = RULE.sub("---", told)
    if NUMBER.sub("#", shown).split() != NUMBER.sub("#", told).split():
        return False
    pairs = zip(NUMBER.findall(shown), NUMBER.findall(told), strict=True)
    return all(float(a) == pytest.approx(float(b), rel=0.1) for a, b in pairs)


@pytest.mark.usefixtures("arx_alone")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_tutorial_does_what_it_says(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if page.name in REAL:
        file, log = REAL[page.name]
        if not log.is_file():
            pytest.skip(f"no {log}")
        shutil.copyfile(log, tmp_path / file)
    if page.name in SIMULATED:
        file, build = SIMULATED[page.name]
        (tmp_path / file).write_bytes(build())
    monkeypatch.chdir(tmp_path)
    for script in re.findall(r"```python\n(.*?)```", page.read_text("utf-8"), re.DOTALL):
        exec(script, {})
    told = blocks(page)
    assert told
    for command, lines in told:
        done = CliRunner().invoke(root, shlex.split(command)[1:], catch_exceptions=False)
        assert done.exit_code in (0, None), done.output
        shown = done.stdout.splitlines()
        wanted = lines[: lines.index("...")] if "..." in lines else lines
        assert len(shown) >= len(wanted), command
        for one, other in zip(shown, wanted, strict=False):
            assert alike(one, other), f"{command}\n{one}\n{other}"
