"""Every error flysid raises on purpose, as one tree.

FlysidError
├── FormatError     the log's fault: not a log, empty, unreadable, hostile
├── UsageError      the caller's fault: arguments, configuration, recipe
│   └── RecipeError     a recipe names what is not there, or is not understood
├── DataError       the data cannot answer: no excitation, too short, not finite
├── StoreError      a stored dataset, run or model file is damaged or of another version
│   └── WriteError      it cannot be written: disk full, read-only, locked
├── PlaceError      a store or a cluster did not answer; the same command goes on where it was
└── FitError        a model could not be fitted: singular, unstable, no rule left

Each carries what happened, where (file, byte, flight time) and what to try. Only the command line
catches them, prints them and chooses the exit code (`exit_code`).
"""

from __future__ import annotations

from pathlib import Path


class FlysidError(Exception):
    """An error that a user can act on.

    Parameters
    ----------
    message : what happened, in one sentence.
    hint : what to try next; empty when there is nothing to try.
    path : the file concerned.
    byte : offset in that file.
    flight_time_s : vehicle time near the fault, in seconds.

    Examples
    --------
    >>> error = flysid.FlysidError("cannot be read", hint="try another", path="a.tlog", byte=12)
    >>> error.byte, error.hint
    (12, 'try another')
    """

    exit_code = 1

    def __init__(
        self,
        message: str,
        *,
        hint: str = "",
        path: str | Path | None = None,
        byte: int | None = None,
        flight_time_s: float | None = None,
    ) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint
        self.path = None if path is None else str(path)
        self.byte = byte
        self.flight_time_s = flight_time_s

    @property
    def where(self) -> str:
        """File, byte and flight time, as far as they are known."""
        parts = []
        if self.path is not None:
            parts.append(self.path)
        if self.byte is not None:
            parts.append(f"byte {self.byte}")
        if self.flight_time_s is not None:
            parts.append(f"flight time {self.flight_time_s:.3f} s")
        return ", ".join(parts)

    @property
    def advice(self) -> str:
        """What happened and what to try, for those who name the file themselves."""
        return f"{self.message}; try: {self.hint}" if self.hint else self.message

    def __str__(self) -> str:
        where = f" ({self.where})" if self.where else ""
        hint = f" Try: {self.hint}" if self.hint else ""
        return f"{self.message}{where}{hint}"


class FormatError(FlysidError):
    """The file is at fault: not a log, empty, unreadable or hostile.

    Examples
    --------
    >>> flysid.read("pyproject.toml")
    Traceback (most recent call last):
    flysid.errors.FormatError: ...
    """


class UsageError(FlysidError):
    """The caller is at fault: arguments or configuration.

    Examples
    --------
    >>> flysid.open("absent")
    Traceback (most recent call last):
    flysid.errors.UsageError: ...
    """

    exit_code = 2


class RecipeError(UsageError):
    """A recipe is not understood, or names a stream or field that the log does not hold.

    Examples
    --------
    >>> flysid.dataset_from("steps.csv", "u", "altitude")
    Traceback (most recent call last):
    flysid.errors.RecipeError: ...
    """


class DataError(FlysidError):
    """The data cannot answer the question: unexcited, too short, not finite.

    Examples
    --------
    >>> flysid.Dataset.from_arrays([0.0, np.nan], [0.0, 1.0], dt_s=0.1)
    Traceback (most recent call last):
    flysid.errors.DataError: ...
    """


class StoreError(FlysidError):
    """A stored dataset, run or model file is damaged or of another version.

    Examples
    --------
    >>> flysid.load("steps.csv")
    Traceback (most recent call last):
    flysid.errors.StoreError: ...
    """

    exit_code = 2


class WriteError(StoreError):
    """Nothing can be written there: disk full, read-only, or in use by another process."""

    exit_code = 1


class PlaceError(FlysidError):
    """A store or a cluster did not answer. What is committed stays; the same command goes on from there."""

    exit_code = 75


class FitError(FlysidError):
    """A model could not be fitted; the message names the cause and the hint a remedy.

    Examples
    --------
    >>> issubclass(flysid.FitError, flysid.FlysidError)
    True
    """
