"""Run by a Python that has onnx: `flysid export` of every model file of a folder, NAME.json to NAME.onnx."""

from __future__ import annotations

import sys
from pathlib import Path

from click.testing import CliRunner

from flysid.cli import root


def main(folder: Path) -> None:
    for path in sorted((folder / "models").glob("*.json")):
        words = ["export", str(path), "--onnx", str(folder / f"{path.stem}.onnx")]
        done = CliRunner().invoke(root, words, standalone_mode=False, catch_exceptions=False)
        assert done.exit_code == 0, done.output


if __name__ == "__main__":
    main(Path(sys.argv[1]))
