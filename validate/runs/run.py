"""A run: models fitted to the training part of a dataset, and all that is needed to judge them later.

```
run/
  <channel>/<label>.json     fitted models
  recipe.toml                the recipe, as it was
  run.json                   written last: data, split, hashes, models, settings, versions
```
The whole folder appears at once: it is made beside its final place and renamed.
"""

from __future__ import annotations

import json
import platform
import tempfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

from flysid.dataset import Dataset
from flysid.datasetfile import DatasetFile, open_dataset
from flysid.errors import StoreError, UsageError
from flysid.foreign import inner_path, read_object, shaped
from flysid.ingest.align.doubts import Doubt
from flysid.ingest.align.recipe import Recipe, load_recipe
from flysid.ingest.lake.chosen_flights import Selection
from flysid.ingest.lake.lake import Lake
from flysid.ingest.lake.lake import open as open_lake
from flysid.manifest import DATA_FILE
from flysid.manifest import RUN_FILE as RUN_FILE
from flysid.model.base import Fitted, load
from flysid.model.own_constants import FlightOffsets
from flysid.model.structures import leaders, row_of
from flysid.place import is_address
from flysid.showing import one_of
from flysid.split import By, Split
from flysid.validate.compare.models import Turn
from flysid.validate.runs.diskparts import LOOK_ROWS, parts_of
from flysid.version import __version__, check_version

RUN_FORMAT = "flysid-run"
RUN_VERSION = 1
RECIPE_FILE = "recipe.toml"
REPORT = "report"
"""Folder of the report inside a run, where none is named."""
DOCUMENT = "report.json"
PAGE = "report.html"
Constants = Literal["auto", "yes", "no"]
LIBRARIES = ("numpy", "scipy", "numba", "pyarrow", "pymavlink", "mcap")


@dataclass(frozen=True)
class FitSettings:
    """Choices of a run; the defaults choose well by themselves.

    Attributes
    ----------
    holdout : share of the data kept for the verdict.
    by : "auto", "flight" or "time"; what the split keeps together.
    seed : of the split and of every random start.
    rules : rule count of the dynamic TS model, or "auto".
    antecedents : variables that choose between rules, or () for automatic choice.
    channels : names to fit; all of the recipe's when empty.
    models : labels to fit besides the references, ARX, OE and the baseline; the usual ones when empty.
        "structured:FILE" is the label "structured" with its file.
    rotate : where too few flights would be held out, judge each by models of the others
        (`flysid.validate.runs.folds`).
    memory_mb : samples of a channel that may be in memory; a channel with more is fitted from disk.
    effort : of the search for rules, "quick", "normal" or "thorough".
    selection : flights and stretches that the user chose.
    held : what is held out instead of a share by chance: flights, or parts of them
        (`flysid.ingest.lake.stretches.parse_part`).
    flight_offsets : whether every flight has a constant of its own beside the models: "auto" where flights
        differ, "yes" or "no" (`flysid.model.flight_offsets`).
    remark : stands above the title of every report on the run, e.g. "simulated flights".
    """

    holdout: float = 0.3
    by: By = "auto"
    seed: int = 7
    rules: int | str = "auto"
    antecedents: tuple[str, ...] = ()
    channels: tuple[str, ...] = ()
    models: tuple[str, ...] = ()
    memory_mb: float = 64.0
    effort: str = "normal"
    rotate: bool = True
    selection: Selection = Selection()  # noqa: RUF009 - frozen
    held: tuple[str, ...] = ()
    remark: str = ""
    flight_offsets: Constants = "auto"

    @property
    def own_constants(self) -> FlightOffsets:
        """`flight_offsets` as structures take it."""
        return {"auto": "auto", "yes": True, "no": False}[self.flight_offsets]  # type: ignore[return-value]

    @property
    def labels(self) -> tuple[str, ...]:
        """`models` without the files that they come from."""
        return tuple(model.partition(":")[0] for model in self.models)


@dataclass(frozen=True)
class FoldRun:
    """Some flights left out, and the models fitted to all others: label -> file in the run's folder."""

    split: Mapping[str, Any]
    models: Mapping[str, str]


@dataclass(frozen=True)
class ChannelRun:
    """What was fitted for one channel.

    Attributes
    ----------
    models : label -> file inside the run's folder.
    split : how the held-out part is found again (`Split.to_dict`).
    aligned : how the dataset was made of the flights, one sentence each.
    fit_seconds : label -> wall time of its fit.
    failed : label -> why that model could not be fitted.
    baseline : label of the linear model that the verdict is against: the best by validation.
    chosen : how the baseline was chosen, one sentence.
    doubts : reasons in the data not to trust any model of it.
    dead_times : what was found of the pairs' dead times and handed to the models, one sentence each.
    loops : where a loop is closed, one sentence per output.
    nonlinear : what share of each output does not follow the inputs linearly, one sentence per output.
    on_disk : fitted from disk; the split is of a dataset file (`flysid.validate.runs.diskparts`).
    folds : where all flights were left out in turn: the split and the models of every turn.
    missing : what could not be given beside the models (`flysid.extras`), one sentence each.
    """

    name: str
    models: Mapping[str, str]
    split: Mapping[str, Any]
    aligned: tuple[str, ...] = ()
    fit_seconds: Mapping[str, float] = field(default_factory=dict)
    failed: Mapping[str, str] = field(default_factory=dict)
    baseline: str = "arx"
    chosen: str = ""
    doubts: tuple[Doubt, ...] = ()
    dead_times: tuple[str, ...] = ()
    loops: tuple[str, ...] = ()
    nonlinear: tuple[str, ...] = ()
    on_disk: bool = False
    folds: tuple[FoldRun, ...] = ()
    missing: tuple[str, ...] = ()


@dataclass(frozen=True)
class Run:
    """A run folder, read back.

    Attributes
    ----------
    data : the ingested folder or the dataset file that it was fitted to.
    recipe : its name; "" where `data` is a dataset file.
    interrupted : the fit was cut short; what it had finished is there.
    """

    folder: Path
    data: str
    recipe: str
    flights: tuple[str, ...]
    settings: FitSettings
    channels: tuple[ChannelRun, ...]
    skipped: Mapping[str, str]
    versions: Mapping[str, str]
    interrupted: bool = False
    _loaded: dict[str, Fitted] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def missing(self) -> tuple[str, ...]:
        """What could not be given beside the models of any channel."""
        return tuple(words for channel in self.channels for words in channel.missing)

    def check_channels(self, names: Collection[str]) -> None:
        """Raise UsageError for a channel that the run neither has nor skipped."""
        known = [c.name for c in self.channels]
        for name in names:
            if name not in known and name not in self.skipped:
                raise UsageError(
                    f"the run has no channel {name!r}", path=self.folder, hint=one_of(known, name)
                )

    def model(self, file: str) -> Fitted:
        """A model file of the run, read once; StoreError where it is missing or damaged."""
        if file not in self._loaded:
            self._loaded[file] = _load(self.folder, file)
        return self._loaded[file]


@dataclass(frozen=True)
class HeldOut:
    """One channel of a run, ready to be judged.

    `seen`: flights that the models were trained on.
    `turns`: the models of every fold, beside the flights that these have not seen.
    """

    channel: ChannelRun
    models: Mapping[str, Fitted]
    train: Dataset
    test: Dataset
    seen: tuple[str, ...]
    turns: tuple[Turn, ...] = ()


Beside = Mapping[str, Mapping[str, Fitted]]
"""Models that a run did not fit, by channel and label."""


def with_models(held: HeldOut, more: Mapping[str, Fitted]) -> HeldOut:
    """The channel with further models. No flight of it is known to them: they are in every turn, too."""
    if not more:
        return held
    turns = tuple(replace(turn, models={**turn.models, **more}) for turn in held.turns)
    return replace(held, models={**held.models, **more}, turns=turns)


def versions() -> dict[str, str]:
    """Versions that a result depends on."""
    found = {"flysid": __version__, "python": platform.python_version()}
    return found | {name: metadata.version(name) for name in LIBRARIES}


def run_document(run: Run) -> bytes:
    """The JSON of a run."""
    body = {
        "format": RUN_FORMAT,
        "version": RUN_VERSION,
        "data": run.data,
        "recipe": run.recipe,
        "flights": run.flights,
        "settings": asdict(run.settings),
        "channels": [_channel_document(c) for c in run.channels],
        "skipped": dict(run.skipped),
        "versions": dict(run.versions),
        "interrupted": run.interrupted,
    }
    return (json.dumps(body, indent=1, allow_nan=False) + "\n").encode()


def _channel_document(channel: ChannelRun) -> dict[str, Any]:
    """Without "missing" where nothing is."""
    return {name: value for name, value in asdict(channel).items() if value or name != "missing"}


# ------------------------------------------------------------------------------------------- reading


def open_run(folder: str | Path) -> Run:
    """Read a run folder back.

    Raises UsageError: no such folder. Raises StoreError: not a run, damaged, or of another version.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise UsageError(
            "a file, not a run folder" if folder.exists() else "no such run folder",
            path=folder,
            hint="make one with 'flysid fit DATA --recipe R -o RUN'",
        )
    path = run_file(folder, RUN_FILE)
    if not path.exists():
        raise StoreError(f"not a run: it has no {RUN_FILE}", path=folder, hint=_meant_by(folder))
    body = read_object(path, "a flysid run", "fit it again")
    if body.get("format") != RUN_FORMAT:
        raise StoreError("not a flysid run", path=path)
    check_version(body.get("version"), RUN_VERSION, "run", path)
    try:
        found = shaped({**body, "folder": folder}, Run)
        if unknown := body["settings"].keys() - asdict(found.settings).keys():
            raise ValueError(f"unknown settings {', '.join(sorted(unknown))}")
        return found
    except ValueError as error:
        raise StoreError(f"the run is damaged: {error}", path=path, hint="fit it again") from error


def _meant_by(folder: Path) -> str:
    """What to do with a folder that is not a run: an ingested folder, or one that holds runs."""
    if (folder / DATA_FILE).is_file():
        return f"this is an ingested folder: 'flysid fit {folder} --recipe R -o RUN' makes a run of it"
    below = sorted(str(p.parent) for p in folder.glob(f"*/{RUN_FILE}"))[:3]
    if below:
        return f"did you mean {' or '.join(map(repr, below))}?"
    return "make one with 'flysid fit DATA --recipe R -o RUN'"


def held_out(run: Run, data: str | Path | None = None) -> list[HeldOut]:
    """The models of a run beside the data that they have not seen.

    Of the training part of a channel that was fitted from disk, only the beginning is given.

    `data`: the ingested folder or the dataset file, where it moved since the fit.
    Raises UsageError: the data is not where it was. Raises StoreError: a model file is missing or damaged.
    Raises DataError: the data differs from what was fitted.
    """
    place = run.data if data is None else data
    if data is None and not is_address(place) and not Path(place).exists():
        raise UsageError(
            "the data that this run was fitted on are missing",
            path=place,
            hint="if it moved, name its place with --data (of 'flysid compare': --data-a, --data-b)",
        )
    if not run.recipe:
        file = open_dataset(place)
        return [_held_out_channel(run, c, file if c.on_disk else file.read()) for c in run.channels]
    then = replace(open_lake(place).only(run.flights), stretches=run.settings.selection.stretches)
    recipe = load_recipe(run_file(run.folder, RECIPE_FILE))
    return [_held_out_of_lake(run, channel, then, recipe) for channel in run.channels]


def _held_out_of_lake(run: Run, channel: ChannelRun, lake: Lake, recipe: Recipe) -> HeldOut:
    if not channel.on_disk:
        return _held_out_channel(run, channel, lake.dataset(recipe, channel.name))
    with tempfile.TemporaryDirectory(prefix="flysid-") as folder:
        path = Path(folder) / "channel.parquet"
        lake.write(recipe, channel.name, path)
        return _held_out_channel(run, channel, open_dataset(path))


def _held_out_channel(run: Run, channel: ChannelRun, data: Dataset | DatasetFile) -> HeldOut:
    models = models_of(run, channel)
    split = Split.from_dict(channel.split)
    if isinstance(data, Dataset):
        seen, unseen = split.apply(data)
        turns = tuple(_turn(run, fold, data, seen.flights) for fold in channel.folds)
        return HeldOut(channel, models, seen, unseen, seen.flights, turns)
    train, test = parts_of(split, data)
    flights = tuple(dict.fromkeys(train.file.entries[p.segment].flight for p in train.pieces))
    return HeldOut(channel, models, train.head(LOOK_ROWS), test.read(), flights)


def _turn(run: Run, fold: FoldRun, data: Dataset, known: Sequence[str]) -> Turn:
    """`known`: flights that the run's own models have seen."""
    models = {label: run.model(file) for label, file in fold.models.items()}
    train, test = Split.from_dict(fold.split).apply(data)
    return Turn(models, test, train.with_segments([s for s in train.segments if s.flight in known]))


def models_of(run: Run, channel: ChannelRun) -> dict[str, Fitted]:
    """The fitted models of a channel by label; StoreError where a file is missing or damaged."""
    return {label: run.model(file) for label, file in channel.models.items()}


def requested_model(labels: Sequence[str], models: Mapping[str, Fitted], baseline: str) -> str | None:
    """Label of the model that the headline speaks of, where no fuzzy one was fitted: the first dynamic one
    that the user requested and that is not the baseline. None leaves the choice to `compare`.
    """
    if any(label in models for label in leaders()):
        return None
    asked = (label for label in labels if label in models and label != baseline)
    return next((label for label in asked if not row_of(models[label].structure).least), None)


def _load(folder: Path, file: str) -> Fitted:
    path = run_file(folder, file)
    if not path.is_file():
        raise StoreError("a model of the run is missing", path=path, hint="fit it again")
    return load(path)


def run_file(folder: Path, name: object) -> Path:
    """A file of a run, whose name stands in its document, or is usual. A run may be a stranger's.

    Raises StoreError: it is not in the folder (`flysid.foreign.inner_path`).
    """
    return inner_path(folder, name, folder / RUN_FILE)
