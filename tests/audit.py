"""The supply chain, judged without a network: what is locked, what is installed, under which licences.

    python -m tests.audit      a table of all packages; ends with 1 where a rule is broken

Rules: every package that flysid or its checks need is locked in `requirements.lock`, with hashes; what is
installed satisfies pyproject.toml; nothing that flysid needs to run has a licence that would bind its users
(`PERMISSIVE`, and weak copyleft by name in `ALLOWED`); files from elsewhere in the tree are what they are
said to be.
"""

from __future__ import annotations

import hashlib
import re
import sys
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
LOCK = ROOT / "requirements.lock"
ASSETS = ROOT / "validate" / "show" / "page" / "assets"
EXTRAS_TO_RUN = ("plot", "xlsx", "bags", "studio", "fleet")
PERMISSIVE = re.compile(
    r"\b(MIT|MIT-CMU|BSD|0BSD|ISC|Apache|PSF-2\.0|Python Software Foundation|Zlib|CC0|any-OSI|HPND)\b", re.I
)
STRONG = re.compile(r"\b(A?GPL|GNU (Affero )?General Public)", re.I)
ALLOWED = {
    "pymavlink": "LGPL: imported as it is; its generated message definitions carry an exception",
    "docutils": "public domain and BSD; the GPL part, a mode of an editor, is not in the package; docs only",
    "certifi": "MPL: a list of certificates, for the browser test",
    "hypothesis": "MPL: tests only",
    "pathspec": "MPL: tests only",
}


@dataclass(frozen=True)
class Package:
    """An installed package, and whether flysid needs it to run (not only to be checked)."""

    name: str
    version: str
    licence: str
    runs: bool


def project() -> dict[str, list[str]]:
    """Requirements of pyproject.toml by extra; "" are those that every installation has."""
    document = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    return {"": document["dependencies"], **document["optional-dependencies"]}


def locked() -> dict[str, tuple[tuple[str, ...], int]]:
    """Name -> versions (there may be one per Python version) and number of hashes in the lock file."""
    found: dict[str, tuple[tuple[str, ...], int]] = {}
    name = ""
    for line in LOCK.read_text("utf-8").splitlines():
        pin = re.match(r"([A-Za-z0-9_.-]+)==([^ ;\\]+)", line)
        if pin:
            name = canonicalize_name(pin[1])
            versions, hashes = found.get(name, ((), 0))
            found[name] = ((*versions, pin[2]), hashes)
        elif "--hash=sha256:" in line:
            found[name] = (found[name][0], found[name][1] + 1)
    return found


def installed(roots: Sequence[str], runs: bool) -> Iterator[Package]:
    """The closure of requirements over what is installed here."""
    waiting = list(roots)
    seen = set[str]()
    while waiting:
        requirement = Requirement(waiting.pop())
        name = canonicalize_name(requirement.name)
        if name in seen or (requirement.marker and not requirement.marker.evaluate({"extra": ""})):
            continue
        seen.add(name)
        try:
            found = metadata.distribution(name)
        except metadata.PackageNotFoundError:
            continue  # an extra that is not installed; `faults` asks for those that must be
        yield Package(name, found.version, licence_of(found), runs)
        waiting += found.requires or []


def licence_of(found: metadata.Distribution) -> str:
    """The licence that a package states: an expression, its classifiers, or the first line of its text."""

    def stated(key: str) -> list[str]:
        return [str(value) for value in found.metadata.get_all(key) or []]

    classifiers = [c.rpartition(" :: ")[2] for c in stated("Classifier") if c.startswith("License")]
    text = "\n".join(stated("License")).strip().splitlines()
    return "; ".join(stated("License-Expression") or classifiers or text[:1])


@cache
def packages() -> list[Package]:
    """Everything that is installed because of flysid, by name."""
    wanted = project()
    run = {p.name: p for p in installed([*wanted[""], *(r for e in EXTRAS_TO_RUN for r in wanted[e])], True)}
    check = {p.name: p for p in installed([r for own in wanted.values() for r in own], False)}
    return [(check | run)[name] for name in sorted(check | run)]


def faults() -> list[str]:
    """Broken rules, one sentence each."""
    return [*_lock_faults(), *_version_faults(), *_licence_faults(), *_vendored_faults()]


def _lock_faults() -> Iterator[str]:
    pins = locked()
    text = LOCK.read_text("utf-8")
    if re.search(r"https?:|file:|--(extra-)?index-url|--find-links|@ ", text):
        yield "the lock file names a host or a place"
    for requirement in (Requirement(r) for own in project().values() for r in own):
        versions, _ = pins.get(canonicalize_name(requirement.name), ((), 0))
        if not versions or not all(requirement.specifier.contains(v, prereleases=True) for v in versions):
            yield f"the lock file does not satisfy {requirement}: {versions or 'not there'}; try: make lock"
    for name, (versions, hashes) in pins.items():
        if hashes < len(versions):
            yield f"{name}=={versions[0]} is locked without a hash"
    for package in packages():
        if package.name not in pins:
            yield f"{package.name} is needed and not locked; try: make lock"


def _version_faults() -> Iterator[str]:
    for requirement in (Requirement(r) for extra in ("", "dev") for r in project()[extra]):
        try:
            version = metadata.version(requirement.name)
        except metadata.PackageNotFoundError:
            yield f"{requirement} is not installed"
            continue
        if not requirement.specifier.contains(version, prereleases=True):
            yield f"{requirement.name} {version} is installed; {requirement.specifier} is asked for"


def _licence_faults() -> Iterator[str]:
    for package in packages():
        if package.name in ALLOWED:
            continue
        if STRONG.search(package.licence) or (package.runs and not PERMISSIVE.search(package.licence)):
            yield f"{package.name} {package.version}: licence {package.licence!r}"


def _vendored_faults() -> Iterator[str]:
    """Files that others wrote: in the table of the assets' README, with hash and licence."""
    table = re.findall(
        r"^\| (\S+) \| .*npm.*|^\| (\S+) \| the same", (ASSETS / "README.md").read_text(), re.M
    )
    named = {a or b for a, b in table}
    for path in sorted(ASSETS.glob("*.min.*")):
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        if path.name not in named or digest not in (ASSETS / "README.md").read_text():
            yield f"{path.name} is not the file that README.md names"
    if "MIT License" not in (ASSETS / "uPlot-LICENSE.txt").read_text():
        yield "uPlot's licence is missing"


def main() -> int:
    """Print the packages, where they differ from the lock, and what is wrong."""
    pins = locked()
    for p in packages():
        versions = pins.get(p.name, ((), 0))[0]
        differs = "" if p.version in versions else f" (locked: {' or '.join(versions) or 'not'})"
        kind = "runs" if p.runs else "checks"
        sys.stdout.write(f"{p.name:28} {p.version:14} {kind:7} {p.licence[:60]}{differs}\n")
    found = faults()
    sys.stdout.writelines(f"FAULT {fault}\n" for fault in found)
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
