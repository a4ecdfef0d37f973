"""Linear models as people store them: .mat, .npz, .json and .m, as fields by name.

No file is run: .mat without objects, .npz without pickles, .m by its literals alone.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from flysid.errors import FormatError, UsageError
from flysid.files import remedy_unread, why_unread
from flysid.outside.matlab_text import Call, read_matlab_text
from flysid.showing import counted

MAX_FILE_BYTES = 64 << 20
CLASS = "class"
"""Field that holds the constructor's name."""
ARGUMENTS: Mapping[str, tuple[str, ...]] = {
    "idpoly": ("a", "b", "c", "d", "f", "noisevariance", "ts"),
    "idss": ("a", "b", "c", "d", "k", "x0", "ts"),
    "idtf": ("num", "den", "ts"),
    "tf": ("num", "den", "ts"),
    "filt": ("num", "den", "ts"),
    "ss": ("a", "b", "c", "d", "ts"),
}
"""The arguments of MATLAB's constructors, in their order."""
OBJECTS = (
    "MATLAB objects cannot be read outside of MATLAB; save their properties there: "
    "s = get(sys); s = rmfield(s, intersect(fieldnames(s), {'Report', 'Structure'})); "
    "save('sys.mat', '-struct', 's', '-v7')"
)


def read_stored(path: Path) -> dict[str, Any]:
    """Field in lower case -> number, array, text or list.

    Raises UsageError: no such file, or no form for its name. Raises FormatError: it holds no model that can
    be read.
    """
    readers: dict[str, Callable[[bytes], Mapping[str, Any]]] = {
        ".mat": _mat,
        ".npz": _npz,
        ".json": _json,
        ".m": _text,
    }
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise UsageError(
            f"no form of a model for {path.name!r}",
            hint="a .mat, .m, .npz or .json file, an .fmu, or module:function",
        )
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise FormatError("too large for a linear model", path=path)
        fields = reader(path.read_bytes())
    except OSError as error:
        raise UsageError(
            f"cannot be read: {why_unread(error)}", path=path, hint=remedy_unread(error)
        ) from error
    except FormatError as error:
        raise FormatError(error.message, hint=error.hint, path=path) from error
    except Exception as error:  # whatever a damaged file breaks is the file's fault
        fault = "not JSON" if isinstance(error, json.JSONDecodeError) else str(error)[:200]
        raise FormatError(f"damaged: {fault}", path=path, hint="write it again") from error
    return {str(name).lower(): value for name, value in fields.items()}


def _mat(content: bytes) -> Mapping[str, Any]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabFunction, MatlabOpaque

    try:
        found = loadmat(io.BytesIO(content), simplify_cells=True)
    except NotImplementedError as error:
        raise FormatError("a .mat file of version 7.3", hint="save it with '-v7'") from error
    own = {name: value for name, value in found.items() if not name.startswith("__")}
    hidden = any(isinstance(v, MatlabOpaque | MatlabFunction) for v in own.values())
    if hidden or (not own and "__function_workspace__" in found):
        raise FormatError("it holds MATLAB objects", hint=OBJECTS)
    structs = {name: value for name, value in own.items() if isinstance(value, dict)}
    if len(structs) > 1:
        raise FormatError(f"it holds {len(structs)} structs: {', '.join(structs)}", hint="save one of them")
    return next(iter(structs.values())) if structs and len(own) == 1 else own


def _npz(content: bytes) -> Mapping[str, Any]:
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def _json(content: bytes) -> Mapping[str, Any]:
    fields = json.loads(content)
    if not isinstance(fields, dict):
        raise FormatError(
            "not a JSON object", hint='{"A": [[...]], "B": ..., "C": ..., "D": ..., "dt": 0.02}'
        )
    return fields


def _text(content: bytes) -> Mapping[str, Any]:
    known = read_matlab_text(content.decode("utf-8"))
    calls = [value for value in known.values() if isinstance(value, Call)]
    if len(calls) > 1:
        raise FormatError(f"it makes {len(calls)} models", hint="keep one in the file")
    if not calls:
        return known
    call = calls[0]
    if call.name not in ARGUMENTS:
        raise FormatError(f"{call.name}() is not known", hint=f"one of {', '.join(ARGUMENTS)}")
    names = ARGUMENTS[call.name]
    if len(call.arguments) > len(names):
        raise FormatError(f"{call.name}() takes {counted(len(names), 'argument')}, not {len(call.arguments)}")
    fields = dict(zip(names, call.arguments, strict=False)) | {CLASS: call.name}
    if call.name == "idpoly" and "a" in fields and len(call.arguments) == 1:
        raise FormatError("a time series has no inputs", hint="save a model with inputs")
    beside: dict[str, Any] = {name: known[name] for name in ("u0", "y0") if name in known}
    constant = {"constant": known["c"]} if "c" in known and "u0" in known else {}  # as flysid itself writes
    return {**beside, **constant, **fields, **{k.lower(): v for k, v in call.properties.items()}}
