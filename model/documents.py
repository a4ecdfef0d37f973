"""Parts of a model file that all structures write and read alike: the head, signals, arrays."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.model.base import MODEL_FORMAT, MODEL_VERSION, Fitted, OperatingPoint


def head_of(model: Fitted) -> dict[str, Any]:
    """What a model file begins with: format, version, structure, sample time and signals."""
    return {
        "format": MODEL_FORMAT,
        "version": MODEL_VERSION,
        "structure": model.structure,
        "dt_s": model.dt_s,
        "inputs": _rows(model.inputs),
        "outputs": _rows(model.outputs),
    }


def _rows(signals: Iterable[Signal]) -> list[list[Any]]:
    return [[s.name, s.unit, s.resolution] for s in signals]


def signals_of(document: Mapping[str, Any], key: str) -> tuple[Signal, ...]:
    """The "inputs" or "outputs" of a model file."""
    return tuple(Signal(str(name), str(unit), float(r)) for name, unit, r in document[key])


def array_of(document: Mapping[str, Any], key: str, *shape: int) -> FloatArray:
    """A finite array of the given shape; -1 for a length that the rest of the file does not tell.

    Raises KeyError: there is none. Raises ValueError: another shape, or not finite.
    """
    values = np.asarray(document[key], dtype=np.float64)
    if values.size == 0 and values.ndim != len(shape):  # lists in lists do not tell what is empty of what
        values = values.reshape([max(size, 0) for size in shape])
    agree = values.ndim == len(shape) and all(
        size in (-1, found) for size, found in zip(shape, values.shape, strict=True)
    )
    if not agree or not np.isfinite(values).all():
        wanted = ", ".join("any" if size < 0 else str(size) for size in shape)
        raise ValueError(f"{key} is not a finite array of shape ({wanted})")
    return values


def monic(values: FloatArray, key: str) -> FloatArray:
    """Coefficients that begin with 1, or with the identity: what a recursion divides by.

    `values`: (p + 1, n_y) polynomials in the delay per output, or (p + 1, n_y, n_y) between outputs.
    Raises ValueError: there are none, or they begin otherwise.
    """
    one = np.eye(values.shape[-1]) if values.ndim == 3 else np.ones(values.shape[-1])
    if not len(values) or np.abs(values[0] - one).max(initial=0.0) > 1e-9:
        raise ValueError(f"{key} does not begin with 1")
    return values


def with_null(array: FloatArray) -> list[Any]:
    """The array as JSON types, null for what is not finite, which JSON does not know; it is read as NaN."""
    return list(np.where(np.isfinite(array), array, None).tolist())  # type: ignore[call-overload]


def array_or_none(value: Any) -> FloatArray | None:
    """What `with_null` or `tolist` wrote, None where there was nothing."""
    return None if value is None else np.array(value, dtype=np.float64)


def points_as_json(points: Sequence[OperatingPoint]) -> list[dict[str, Any]]:
    """Operating points as JSON types."""
    return [
        {k: with_null(v) if isinstance(v, np.ndarray) else v for k, v in asdict(p).items()} for p in points
    ]


def points_from(documents: Sequence[Mapping[str, Any]]) -> tuple[OperatingPoint, ...]:
    """What `points_as_json` wrote; files of before operating points hold none."""
    return tuple(
        OperatingPoint(
            **{
                f.name: _number_or_array(document[f.name])
                for f in fields(OperatingPoint)
                if f.name in document
            }
        )
        for document in documents
    )


def _number_or_array(value: Any) -> Any:
    return np.array(value, dtype=np.float64) if isinstance(value, list) else value
