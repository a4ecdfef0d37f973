"""A release up to the upload: archives in dist/, tried in an empty environment, and an annotated tag.

    python -m tests.release [--checks TARGETS] [ADDRESS]

First the targets of the Makefile must pass. The rest is done in a clone, so that the archives hold what is
committed and nothing else. The clone dates the version in CHANGELOG.md, commits that, and tags it with the
version's changes and a sign-off. The tree here is moved to that commit at the very end: whatever fails leaves
no commit and no tag. ADDRESS is where the repository can be read (else an https origin): the index's copy of
the README has links to there, and the archives name it as the project's home. Without one, that copy has no
pictures and no links.
"""

from __future__ import annotations

import argparse
import datetime
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import venv
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from flysid.version import __version__

ROOT = Path(__file__).resolve().parents[1]
TAG = f"v{__version__}"
LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!https?:|#)([^)]+)\)")
LINKED = ("ingest", "model", "validate")  # at the top, and in the wheel below flysid
SAMPLE = "sample_logs/01-steps-seed2.tlog"


class Refused(Exception):
    """Why no release is made, and what to do."""


def git(folder: Path, *words: str) -> str:
    return subprocess.run(["git", *words], cwd=folder, check=True, capture_output=True, text=True).stdout


def refuse_unready(root: Path) -> None:
    """A tree that is not clean, or a version that has its tag, is not released."""
    if changed := git(root, "status", "--porcelain"):
        raise Refused(f"these files are not committed; commit them first:\n{changed.rstrip()}")
    if git(root, "tag", "--list", TAG):
        raise Refused(f"{TAG} is there; raise the version in flysid/version.py and pyproject.toml")


def dated(changelog: str, version: str, day: str) -> str:
    """The changelog with what was unreleased under the version and its day, once."""
    if f"## [{version}] - " in changelog:
        return changelog
    return changelog.replace("## [Unreleased]", f"## [Unreleased]\n\n## [{version}] - {day}", 1)


def changes(changelog: str, version: str) -> str:
    """What the changelog says of a version."""
    found = re.search(rf"^## \[{re.escape(version)}\] - \S+\n(.*?)(?=^## |\Z)", changelog, re.M | re.S)
    if found is None or not found[1].strip():
        raise Refused(f"CHANGELOG.md says nothing of {version}: write it under '## [Unreleased]'")
    return found[1].strip()


def for_an_index(readme: str, address: str) -> str:
    """The README as a package index can show it: every link leads to `address`, or is its words alone."""

    def outside(link: re.Match[str]) -> str:
        if not address:
            return "" if link[1] else link[2]
        return f"{link[1]}[{link[2]}]({address}/{'raw' if link[1] else 'blob'}/{TAG}/{link[3]})"

    return LINK.sub(outside, readme)


def project_urls(address: str) -> str:
    """The table of pyproject.toml."""
    if not address:
        return ""
    return (
        f'\n[project.urls]\nHomepage = "{address}"\nIssues = "{address}/issues"\n'
        f'Documentation = "{address}/blob/{TAG}/docs/index.md"\n'
        f'Changelog = "{address}/blob/{TAG}/CHANGELOG.md"\n'
    )


def missing(committed: list[str], wheel: list[str], source: list[str]) -> Iterator[str]:
    """Committed files that an archive lacks: the source archive has all, the wheel the package's own."""
    in_wheel = set(wheel)
    in_source = {name.partition("/")[2] for name in source}
    for name in committed:
        top = name.partition("/")[0]
        installed = f"flysid/{name}" if top in LINKED else name
        if top in ("flysid", *LINKED) and name not in {f"flysid/{n}" for n in LINKED}:
            if installed not in in_wheel:
                yield f"wheel: {installed}"
            if not {name, installed} & in_source:
                yield f"source archive: {name}"
        elif top not in (".ci", ".gitignore", "flysid") and name not in in_source:
            yield f"source archive: {name}"


def build(clone: Path, out: Path) -> tuple[Path, Path]:
    """Wheel and source archive, passed by twine, with nothing missing."""
    subprocess.run(
        [sys.executable, "-m", "build", "--outdir", out, clone], check=True, capture_output=True, text=True
    )
    (wheel,) = out.glob("*.whl")
    (source,) = out.glob("*.tar.gz")
    subprocess.run([sys.executable, "-m", "twine", "check", "--strict", wheel, source], check=True)
    with tarfile.open(source) as archive:
        lost = list(missing(
            git(clone, "ls-files").splitlines(), zipfile.ZipFile(wheel).namelist(), archive.getnames()
        ))  # fmt: skip
    if lost:
        raise Refused("\n".join(["the archives lack committed files:", *lost]))
    return wheel, source


def try_out(wheel: Path, log: Path, place: Path) -> None:
    """The wheel in an empty environment reads a log."""
    venv.create(place, with_pip=True)
    subprocess.run([place / "bin" / "python", "-m", "pip", "install", "--quiet", wheel], check=True)
    flysid = place / "bin" / "flysid"
    said = subprocess.run([flysid, "--version"], check=True, capture_output=True, text=True).stdout
    if __version__ not in said:
        raise Refused(f"the wheel says {said.strip()!r}, not {__version__}")
    subprocess.run([flysid, "doctor", log], check=True, cwd=place, stdout=subprocess.DEVNULL)


def release(root: Path, address: str, checks: Sequence[str] = ()) -> list[Path]:
    """The archives, and the tag; nothing is left behind where a step fails."""
    refuse_unready(root)
    if checks:
        subprocess.run(["make", "--no-print-directory", *checks], cwd=root, check=True)
    with tempfile.TemporaryDirectory() as held:
        clone = Path(held) / "flysid"
        git(root, "clone", "--quiet", str(root), str(clone))
        who = [f"{key}={git(root, 'config', key).strip()}" for key in ("user.name", "user.email")]
        own = [word for setting in who for word in ("-c", setting)]
        path = clone / "CHANGELOG.md"
        before = path.read_text("utf-8")
        path.write_text(
            dated(before, __version__, datetime.datetime.now(datetime.UTC).date().isoformat()), "utf-8"
        )
        notes = changes(path.read_text("utf-8"), __version__)
        if path.read_text("utf-8") != before:
            git(clone, *own, "commit", "--all", "--signoff", "--message", f"Release {__version__}")
        head = git(clone, "rev-parse", "HEAD").strip()
        for name, text in (
            ("README.md", for_an_index((clone / "README.md").read_text("utf-8"), address)),
            ("pyproject.toml", (clone / "pyproject.toml").read_text("utf-8") + project_urls(address)),
        ):
            (clone / name).write_text(text, "utf-8")
        built = build(clone, Path(held) / "dist")
        try_out(built[0], clone / SAMPLE, Path(held) / "empty")
        signed = f"Signed-off-by: {who[0].partition('=')[2]} <{who[1].partition('=')[2]}>"
        text = f"flysid {__version__}\n\n{notes}\n\n{signed}\n"
        git(clone, *own, "tag", "--annotate", "--cleanup=verbatim", "--message", text, TAG, head)
        out = root / "dist"
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(Path(held) / "dist", out)
        git(root, "pull", "--quiet", "--ff-only", "--tags", str(clone), "HEAD")
    return [out / path.name for path in built]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("address", nargs="?", default="")
    parser.add_argument("--checks", default="test audit docs")
    given = parser.parse_args()
    address = given.address
    if not address:
        origin = subprocess.run(
            ["git", "remote", "get-url", "origin"], cwd=ROOT, capture_output=True, text=True, check=False
        ).stdout
        address = origin.strip().removesuffix(".git") if origin.startswith("https://") else ""
    try:
        built = release(ROOT, address.rstrip("/"), given.checks.split())
    except Refused as error:
        sys.exit(f"no release: {error}")
    except subprocess.CalledProcessError as error:
        sys.exit(f"no release: {' '.join(map(str, error.cmd))} failed; {error.stderr or 'see above'}")
    lines = [f"{path.relative_to(ROOT)}  {path.stat().st_size / 1e6:.1f} MB" for path in built]
    if not address:
        lines.append(
            "no address: the archives name no home, and their README has no links (ADDRESS=https://...)"
        )
    lines.append(f"{TAG} is tagged. To publish: git push --follow-tags && python -m twine upload dist/*")
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
