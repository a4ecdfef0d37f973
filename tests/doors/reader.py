"""A reader: types the lines of a page into a shell, in a folder, and looks at what comes back."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from tests.command import ROOT

COUNTED = Path(__file__).with_name("counted.py")
TIMEOUT_S = 1800.0
Done = subprocess.CompletedProcess[str]


@dataclass(frozen=True)
class Running:
    """A line that has not ended yet."""

    line: str
    process: subprocess.Popen[bytes]
    out: Path
    err: Path

    def wait_for(self, there: Callable[[], object]) -> None:
        """Until `there`; an error where the line ends before, or the time is up."""
        end = time.monotonic() + TIMEOUT_S
        while not there():
            if self.process.poll() is not None or time.monotonic() > end:
                raise AssertionError(f"{self.line}\n{self.out.read_text()}{self.err.read_text()}")
            time.sleep(0.05)

    def wait_for_words(self, words: str) -> None:
        """Until it has printed these, on either stream."""
        self.wait_for(lambda: words in self.out.read_text("utf-8") + self.err.read_text("utf-8"))


@dataclass
class Reader:
    """Commands run in `folder`, flysid's own environment first on the path, a home beside the folder."""

    folder: Path
    more: dict[str, str] = field(default_factory=dict)
    cpu_s: float = 0.0
    ending: ExitStack = field(default_factory=ExitStack)
    _count: int = 0

    def run(self, line: str, said: str = "") -> Done:
        """A line, until it ends by itself; `said` is what the reader answers to its questions."""
        with self.running(line, said) as running:
            running.process.wait(TIMEOUT_S)
        return self._done(running)

    def run_while(self, line: str, act: Callable[[Running], None]) -> Done:
        """A line that runs until Ctrl-C, which comes after `act`."""
        with self.running(line) as running:
            act(running)
            with suppress(ProcessLookupError):  # it has ended by itself
                os.killpg(running.process.pid, signal.SIGINT)
            running.process.wait(TIMEOUT_S)
        return self._done(running)

    def prepare(self, *lines: str) -> None:
        """Lines that are not the page's; they have to succeed."""
        for line in lines:
            done = self.run(line)
            assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"

    @contextmanager
    def running(self, line: str, said: str = "") -> Iterator[Running]:
        """The process of a line; whatever it started has ended, and is counted, afterwards."""
        self._count += 1
        counts, out, err, own = (self.beside(f"{self._count}.{kind}") for kind in ("cpu", "out", "err", "in"))
        own.write_text(said, "utf-8")
        with own.open("rb") as answers, out.open("wb") as told, err.open("wb") as warned:
            process = subprocess.Popen(
                [sys.executable, "-I", "-S", str(COUNTED), str(counts), line],
                cwd=self.folder,
                env=self._environment(),
                stdin=answers,
                stdout=told,
                stderr=warned,
                start_new_session=True,
            )
        try:
            yield Running(line, process, out, err)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
            if counts.is_file():
                self.cpu_s += float(counts.read_text("utf-8"))

    def beside(self, name: str) -> Path:
        """A path of this reader outside the folder."""
        return self.folder.with_name(f"{self.folder.name}.{name}")

    def _done(self, ended: Running) -> Done:
        told, warned = (file.read_text("utf-8") for file in (ended.out, ended.err))
        return Done(ended.line, ended.process.returncode, told, warned)

    def _environment(self) -> dict[str, str]:
        """That of a reader who has set flysid up and nothing else; fonts are found once for all pages."""
        home = self.beside("home")
        home.mkdir(exist_ok=True)
        kept = {name: value for name, value in os.environ.items() if not name.startswith(("FLYSID_", "XDG_"))}
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        fonts = os.environ.get("MPLCONFIGDIR", str(Path.home() / ".cache" / "matplotlib"))
        own = {"PATH": path, "HOME": str(home), "PYTHONPATH": str(ROOT), "NO_COLOR": "1", "BROWSER": "true"}
        return kept | own | {"MPLCONFIGDIR": fonts} | self.more
