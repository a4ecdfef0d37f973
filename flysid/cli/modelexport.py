"""What `flysid export` does with a run or a model file: which model is meant, and where it goes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from flysid.cli.output import check_target, say
from flysid.errors import UsageError

if TYPE_CHECKING:
    from flysid.dataset import Dataset
    from flysid.export.fmu import FMIVersion
    from flysid.export.pysource import Dialect
    from flysid.model.base import Fitted
    from flysid.validate.runs.run import ChannelRun, Run


@dataclass(frozen=True)
class Wanted:
    """What the command line says of the model to export."""

    source: Path
    channel: str
    label: str
    rate_hz: float | None
    data: Path | None
    single: bool = False
    fmi: FMIVersion = 2


@dataclass(frozen=True)
class ChosenModel:
    """The model that is meant: its name for code, and the run that it comes from."""

    name: str
    model: Fitted
    run: Run | None = None
    channel: ChannelRun | None = None

    def training_part(self, data: Path | None) -> Dataset:
        """What the model was fitted to. Raises UsageError: a model file has no run, or its data are gone."""
        from flysid.validate.runs.run import held_out

        if self.run is None or self.channel is None:
            raise UsageError(
                "a model file does not say what it was trained on, and float32 is tried on that",
                hint="give the run's folder, or leave out --float32",
            )
        return held_out(replace(self.run, channels=(self.channel,)), data)[0].train


Content = Callable[[ChosenModel, Wanted, Path], "dict[str, str] | list[bytes]"]
"""The texts of a folder by name, or the bytes of a file and of those beside it."""
ENDINGS = {"casadi": (".py",), "jax": (".py",), "onnx": (".onnx",), "lpv": (".json", ".mat")}


def find_model(wanted: Wanted) -> ChosenModel:
    """The model of a run, or of a file.

    Raises UsageError: no such file, channel or model; several channels and no --channel. Raises StoreError:
    not a run or a model file, or damaged.
    """
    from flysid.export.csource import identifier
    from flysid.model.base import load
    from flysid.validate.compare.models import headline
    from flysid.validate.runs.run import models_of, open_run

    if not wanted.source.is_dir():
        if not wanted.source.exists():
            raise UsageError("no such run or model file", path=wanted.source)
        return ChosenModel(identifier(wanted.channel or wanted.source.stem), load(wanted.source))
    run = open_run(wanted.source)
    names = [c.name for c in run.channels]
    if wanted.channel not in names and (wanted.channel or len(names) > 1):
        what = f"no channel {wanted.channel!r}" if wanted.channel else f"{len(names)} channels"
        raise UsageError(f"the run has {what}", hint="--channel " + ", or --channel ".join(names))
    channel = run.channels[names.index(wanted.channel) if wanted.channel else 0]
    models = models_of(run, channel)
    label = wanted.label or headline(models, channel.baseline)
    if label not in models:
        raise UsageError(
            f"the channel {channel.name!r} has no model {label!r}", hint=f"--model {', '.join(models)}"
        )
    if not wanted.label:
        others = ", ".join(sorted({*models} - {label}))
        say(f"{channel.name}: the model {label!r}; others with --model: {others}")
    return ChosenModel(identifier(channel.name), models[label], run, channel)


def write_model(wanted: Wanted, target: str, place: Path, *, force: bool) -> None:
    """Write a model for a target: a folder of C or MATLAB, or a file; beside an ONNX graph its names.

    Raises UsageError: another ending than the target's; the package onnx is missing; float32 costs too much;
    as `find_model`.
    """
    from flysid.files import replacing_folder, write_atomically, writing_to

    ends = ENDINGS.get(target, ())
    if ends and place.suffix not in ends:
        hint = (
            f"--lpv F{' or --lpv F'.join(ends)}" if target == "lpv" else f"--{target} {place.stem}{ends[0]}"
        )
        raise UsageError(f"unknown file type: {place.name!r}", hint=hint)
    files = [place, place.with_suffix(".json")] if target == "onnx" else [place]
    for file in files:
        check_target(file, force)
    content = _CONTENT[target](find_model(wanted), wanted, place)
    if isinstance(content, dict):
        with replacing_folder(place) as folder:
            for name, text in content.items():
                (folder / name).write_text(text, "utf-8")
        return
    with writing_to(place):
        for file, written in zip(files, content, strict=True):
            write_atomically(file, written)


def _c(found: ChosenModel, wanted: Wanted, _: Path) -> dict[str, str]:
    from flysid.export.csource import c_files
    from flysid.export.programs import program_of
    from flysid.export.single import loss_in_float32

    program = program_of(found.model, wanted.rate_hz)
    train = found.training_part(wanted.data) if wanted.single else None
    loss = None if train is None else loss_in_float32(found.model, program, train)
    return c_files(program, found.name, loss)


def _matlab(found: ChosenModel, wanted: Wanted, _: Path) -> dict[str, str]:
    from flysid.export.matlab import matlab_files
    from flysid.export.programs import program_of

    return matlab_files(found.model, program_of(found.model, wanted.rate_hz), found.name)


def _fmu(found: ChosenModel, wanted: Wanted, _: Path) -> list[bytes]:
    from flysid.export.fmu import fmu_bytes
    from flysid.export.programs import program_of

    return [fmu_bytes(program_of(found.model, wanted.rate_hz), found.name, version=wanted.fmi)]


def _lpv(found: ChosenModel, wanted: Wanted, place: Path) -> list[bytes]:
    from flysid.export.lpv import to_lpv

    lpv = to_lpv(found.model, wanted.rate_hz)
    return [lpv.to_mat() if place.suffix == ".mat" else lpv.to_json().encode()]


def _python(dialect: Dialect) -> Content:
    """Functions that need one package alone."""

    def content(found: ChosenModel, wanted: Wanted, _: Path) -> list[bytes]:
        from flysid.export.programs import members_of
        from flysid.export.pysource import python_file

        return [python_file(members_of(found.model, wanted.rate_hz), found.name, dialect).encode()]

    return content


def _onnx(found: ChosenModel, wanted: Wanted, _: Path) -> list[bytes]:
    """A graph in float32, tried on the training data of a run; of a model file its poles are looked at."""
    from flysid.export.onnx_graph import names_json, onnx_bytes
    from flysid.export.programs import members_of
    from flysid.export.single import refuse_poles, worst_loss_in_float32

    members = members_of(found.model, wanted.rate_hz)
    loss = None
    if found.run is not None:
        loss = worst_loss_in_float32(found.model, found.training_part(wanted.data), wanted.rate_hz)
    for member in members:
        refuse_poles(member.program)
    return [onnx_bytes(members, found.name), names_json(members, loss).encode()]


_CONTENT: Mapping[str, Content] = {
    "c": _c,
    "fmu": _fmu,
    "matlab": _matlab,
    "lpv": _lpv,
    "casadi": _python("casadi"),
    "jax": _python("jax"),
    "onnx": _onnx,
}
