"""What `flysid export` does with a run or a model file: which model is meant, and where it goes."""

from __future__ import annotations

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


@dataclass(frozen=True)
class ChosenModel:
    """The model that is meant: its name for code, and the run that it comes from."""

    name: str
    model: Fitted
    run: Run | None = None
    channel: ChannelRun | None = None

    def training_part(self, data: Path | None) -> Dataset:
        """What the model was fitted to.

        Raises
        ------
        UsageError : a model file has no run, or its data are gone.
        """
        from flysid.validate.runs.run import held_out

        if self.run is None or self.channel is None:
            raise UsageError(
                "a model file does not say what it was trained on, and float32 is tried on that",
                hint="give the run's folder, or leave out --float32",
            )
        return held_out(replace(self.run, channels=(self.channel,)), data)[0].train


def find_model(wanted: Wanted) -> ChosenModel:
    """The model of a run, or of a file.

    Raises
    ------
    UsageError : no such file, channel or model; several channels and no --channel.
    StoreError : not a run or a model file, or damaged.
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


def write_c(wanted: Wanted, folder: Path, *, single: bool, force: bool) -> None:
    """Write the C of a model into a new folder."""
    from flysid.export.csource import c_files
    from flysid.export.programs import program_of
    from flysid.export.single import loss_in_float32
    from flysid.files import replacing_folder

    check_target(folder, force)
    found = find_model(wanted)
    program = program_of(found.model, wanted.rate_hz)
    loss = loss_in_float32(found.model, program, found.training_part(wanted.data)) if single else None
    with replacing_folder(folder) as place:
        for file, text in c_files(program, found.name, loss).items():
            (place / file).write_text(text, "utf-8")


def write_fmu(wanted: Wanted, file: Path, version: FMIVersion, *, force: bool) -> None:
    """Write the FMU of a model."""
    from flysid.export.fmu import fmu_bytes
    from flysid.export.programs import program_of
    from flysid.files import write_atomically, writing_to

    check_target(file, force)
    found = find_model(wanted)
    content = fmu_bytes(program_of(found.model, wanted.rate_hz), found.name, version=version)
    with writing_to(file):
        write_atomically(file, content)


def write_matlab(wanted: Wanted, folder: Path, *, force: bool) -> None:
    """Write the MATLAB text of a model into a new folder."""
    from flysid.export.matlab import matlab_files
    from flysid.export.programs import program_of
    from flysid.files import replacing_folder

    check_target(folder, force)
    found = find_model(wanted)
    program = program_of(found.model, wanted.rate_hz)
    with replacing_folder(folder) as place:
        for file, text in matlab_files(found.model, program, found.name).items():
            (place / file).write_text(text, "utf-8")


def write_lpv(wanted: Wanted, file: Path, *, force: bool) -> None:
    """Write a model in linear parameter-varying form, as JSON or for MATLAB by the file's name.

    Raises
    ------
    UsageError : the name ends in neither .json nor .mat.
    """
    from flysid.export.lpv import to_lpv
    from flysid.files import write_atomically, writing_to

    check_target(file, force)
    if file.suffix not in (".json", ".mat"):
        raise UsageError(f"unknown file type: {file.name!r}", hint="--lpv F.json or --lpv F.mat")
    lpv = to_lpv(find_model(wanted).model, wanted.rate_hz)
    with writing_to(file):
        write_atomically(file, lpv.to_mat() if file.suffix == ".mat" else lpv.to_json().encode())


def write_python(wanted: Wanted, file: Path, dialect: Dialect, *, force: bool) -> None:
    """Write a model as Python functions that need one package alone.

    Raises
    ------
    UsageError : the name does not end in .py.
    """
    from flysid.export.programs import members_of
    from flysid.export.pysource import python_file
    from flysid.files import write_atomically, writing_to

    check_target(file, force)
    require_ending(file, ".py", dialect)
    found = find_model(wanted)
    text = python_file(members_of(found.model, wanted.rate_hz), found.name, dialect)
    with writing_to(file):
        write_atomically(file, text.encode())


def write_onnx(wanted: Wanted, file: Path, *, force: bool) -> None:
    """Write a model as an ONNX graph in float32, and beside it a JSON of the same name.

    A run's model is tried in float32 on its training data first; of a model file its poles are looked at.

    Raises
    ------
    UsageError : the name does not end in .onnx; the package onnx is missing; float32 costs too much.
    """
    from flysid.export.onnx_graph import names_json, onnx_bytes
    from flysid.export.programs import members_of
    from flysid.export.single import refuse_poles, worst_loss_in_float32
    from flysid.files import write_atomically, writing_to

    names = file.with_suffix(".json")
    require_ending(file, ".onnx", "onnx")
    check_target(file, force)
    check_target(names, force)
    found = find_model(wanted)
    members = members_of(found.model, wanted.rate_hz)
    loss = None
    if found.run is not None:
        train = found.training_part(wanted.data)
        loss = worst_loss_in_float32(found.model, train, wanted.rate_hz)
    for member in members:
        refuse_poles(member.program)
    content = onnx_bytes(members, found.name)
    with writing_to(file):
        write_atomically(file, content)
        write_atomically(names, names_json(members, loss).encode())


def require_ending(file: Path, ending: str, option: str) -> None:
    """Raise UsageError where a file's name has another ending than its option writes."""
    if file.suffix != ending:
        raise UsageError(f"unknown file type: {file.name!r}", hint=f"--{option} {file.stem}{ending}")
