"""A model that flysid did not make, from wherever it is."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from flysid.errors import FlysidError, UsageError
from flysid.model.base import MODEL_FORMAT, Fitted, load
from flysid.outside.fmu_simulator import fmu_model
from flysid.outside.function_simulator import function_model
from flysid.outside.like import Like
from flysid.outside.linear_system import linear_model
from flysid.outside.stored import read_stored

FUNCTION = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")
WANTED = re.compile(r"(?:(?P<channel>[^/=]+)/)?(?P<label>[\w.+-]+)=(?P<source>.+)")


def bring(source: str, like: Like, starts: Sequence[str] = ()) -> Fitted:
    """A model of `like`'s signals.

    `source`: a .mat, .m, .npz or .json file, an .fmu, or module:function.
    `starts`: of an FMU: variables that a run starts from.
    Raises UsageError: it cannot be found or run, or is a model of something else. Raises FormatError: the
    file is damaged or holds something else.
    """
    path = Path(source)
    if path.suffix.lower() == ".fmu":
        return fmu_model(path, like, starts)
    if starts:
        raise UsageError(
            f"{source} is not an FMU and has no variable to start from", hint="leave out --start"
        )
    if not path.exists() and FUNCTION.fullmatch(source):
        return function_model(source, like)
    fields = read_stored(path)
    if fields.get("format") == MODEL_FORMAT:
        return load(path)
    try:
        return linear_model(fields, like, path.name)
    except UsageError as error:
        raise UsageError(error.message, hint=error.hint, path=path) from error


def brought(
    wanted: Sequence[str], channels: Mapping[str, Mapping[str, Fitted]], starts: Sequence[str] = ()
) -> dict[str, dict[str, Fitted]]:
    """Channel -> label -> model, of "[CHANNEL/]LABEL=SOURCE"; without a channel, of the one with its signals.

    `channels`: the models of a run, by channel and label.
    `starts`: "LABEL=VARIABLE" of FMUs.
    Raises UsageError: not understood, a label that is taken, a start of no model, or a model of no channel.
    Else as `bring`.
    """
    labels = {match["label"] for text in wanted if (match := WANTED.fullmatch(text))}
    begins: dict[str, list[str]] = {}
    for text in starts:
        label, _, variable = text.partition("=")
        if label not in labels or not variable:
            raise UsageError(
                f"{text!r} is not the start of any model", hint="LABEL=VARIABLE, LABEL as in --with"
            )
        begins.setdefault(label, []).append(variable)
    found: dict[str, dict[str, Fitted]] = {}
    for text in wanted:
        match = WANTED.fullmatch(text)
        if match is None:
            raise UsageError(f"{text!r} is not understood", hint="LABEL=FILE, or CHANNEL/LABEL=FILE")
        channel = match["channel"]
        label = match["label"]
        source = match["source"]
        if channel is not None and channel not in channels:
            raise UsageError(f"the run has no channel {channel!r}", hint=f"one of {', '.join(channels)}")
        fits: list[str] = []
        why: FlysidError | None = None
        for name in [channel] if channel is not None else channels:
            if label in channels[name] or label in found.get(name, {}):
                raise UsageError(f"the channel {name} has a model {label!r} already", hint="another label")
            try:
                model = bring(source, Like.of(next(iter(channels[name].values()))), begins.get(label, ()))
            except UsageError as error:
                why = why or error
                continue
            found.setdefault(name, {})[label] = model
            fits.append(name)
        if why is not None and not fits:
            raise why
        if len(fits) > 1:
            raise UsageError(
                f"{source} may be a model of {', '.join(fits)}", hint=f"name one: {fits[0]}/{label}={source}"
            )
    return found
