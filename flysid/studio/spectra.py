"""A flight's spectrum and filters as the page shows them: words and picture of the two verbs."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from flysid.reviews.field_spectra import FieldSpectrum, field_spectra
from flysid.reviews.filter_trial import crossover_of, try_filters
from flysid.reviews.logged import LoggedFlight
from flysid.studio.flights import lake_of
from flysid.studio.folders import Workspace


class Spectra:
    """Spectra and filters of a studio's flights; all methods raise NotThere where a flight is not there."""

    def __init__(self, workspace: Workspace) -> None:
        self._data = workspace.data

    def spectrum(self, flight: str) -> dict[str, Any]:
        """What `flysid spectrum` prints, and its document.

        Raises UsageError: the log holds nothing of which there is a spectrum.
        """
        spectra = _spectra(self._log(flight))
        lines = [line for spectrum in spectra for line in spectrum.lines()]
        return {"lines": lines, "spectra": [spectrum.to_dict() for spectrum in spectra]}

    def picture(self, flight: str) -> bytes:
        """The picture that `flysid spectrum --plot` draws, as SVG; raises as `spectrum`."""
        from flysid.reviews.spectrum_plot import draw_spectra

        log = self._log(flight)
        with TemporaryDirectory() as folder:
            path = Path(folder) / "spectrum.svg"
            draw_spectra(log, _spectra(log), None, None, path)
            return path.read_bytes()

    def filters(self, flight: str, more: tuple[str, ...], without: tuple[str, ...]) -> dict[str, Any]:
        """The table that `flysid filters` prints, and its notes.

        `more`, `without`: filters to try, and parts of the names of those to take away.
        Raises UsageError: a filter is not written as one.
        """
        log = self._log(flight)
        hz, known_from = crossover_of(log)
        trial = try_filters(log, more, without, crossover_hz=hz, crossover_from=known_from)
        return {"rows": trial.rows(), "notes": trial.notes()}

    def _log(self, flight: str) -> LoggedFlight:
        log = lake_of(self._data, flight).logs[0]
        return LoggedFlight(log, log.manifest.damage, log.manifest.source.name)


def _spectra(log: LoggedFlight) -> list[FieldSpectrum]:
    return list(field_spectra(log, ()))
