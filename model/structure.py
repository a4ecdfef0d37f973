"""A row of the table of model structures (`flysid.model.structures`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from flysid.offers import import_name

Kind = Literal["reference", "linear", "rules", "physics", "other"]
Fitting = Literal["always", "usually", "on request"]
Gate = Literal["nothing", "held value", "linear models"]
SETTINGS = ("antecedents", "file", "flight_offsets", "nk_hint", "nk_least", "rules", "search", "seed")
"""What a run can hand to a structure's settings.

`antecedents`, `rules` and `flight_offsets` as `flysid.TS` takes them; `file`, the path behind "LABEL:";
`nk_hint`, delays per input in samples that the data speak for; `nk_least`, those below which the data show no
answer; `search`, a `flysid.SearchSettings`; `seed` of random starts.
"""


@dataclass(frozen=True)
class Structure:
    """A model structure.

    `name`: what `flysid fit --models`, a run's folder and the reports call it: small letters, digits, _ and
        -.
    `rebuild`: "module:function" that makes a fitted model of its `to_dict()`; "" where the models that it
        fits are stored as those of other rows.
    `stored`: what model files call it (`Fitted.structure`), where that is not `name`.
    `estimator`: "module:Class" of its settings, public as `flysid.Class`.
    `build`: "module:function" that makes the settings for a run, where `estimator` cannot. It may return None
        where the run's other settings leave this structure out.
    `takes`: names of `SETTINGS` that either of them is given, by keyword.
    `kind`: "reference", a line to stay below; "linear", what rules have to beat; "rules"; "physics",
        equations of the vehicle; "other".
    `gate`: what its free run over the training data is held to before it is delivered: "held value", the
        first outputs for ever; "linear models", those and the linear models beside it; "nothing".
    `fitted`: whether a run fits it "always", "usually" (where `--models` is not given) or "on request".
    `competes`: stands among the candidates for the baseline.
    `leads`: the headline speaks of it where it was fitted; the first such row wins.
    `streams`: its settings' `fit` reads a `flysid.validate.runs.diskparts.FilePart`, block by block.
    `has_memory`: its output depends on the past.
    `cost`: of a fit, in fits of an ARX model. It only times the progress bar.
    `words`: what sentences call it: "fuzzy model"; its name where "".
    `least`: what a sentence calls it where a model with memory is no better than it: "a static line".
    `title`: heads a program made of it: "ARX model".
    `program`: "module:function" that makes one step of a fitted model (`flysid.export.program.Program`); ""
        where it cannot be exported.
    `pieces`: "module:function" that makes of a fitted model what predicts a record in pieces
        (`flysid.model.in_pieces.InPieces`), or None; where "", the latest seconds are predicted again.
    `package`: that it comes from; "" for flysid's own.

    >>> from flysid.model.structures import Structure
    >>> row = Structure("mine", "mine.model:from_dict", estimator="mine.model:Mine", takes=("seed",))
    >>> row.file_name, row.kind, row.gate
    ('mine', 'other', 'linear models')
    """

    name: str
    rebuild: str = ""
    stored: str = ""
    estimator: str = ""
    build: str = ""
    takes: tuple[str, ...] = ()
    kind: Kind = "other"
    gate: Gate = "linear models"
    fitted: Fitting = "on request"
    competes: bool = False
    leads: bool = False
    streams: bool = False
    has_memory: bool = True
    cost: float = 1.0
    words: str = ""
    least: str = ""
    title: str = ""
    program: str = ""
    pieces: str = ""
    package: str = ""

    @property
    def file_name(self) -> str:
        """What model files call it."""
        return self.stored or self.name

    @property
    def called(self) -> str:
        """What a sentence calls it."""
        return self.words or self.name

    @property
    def can_be_fitted(self) -> bool:
        """Whether a run can fit it; a row may be there for its model files alone."""
        return bool(self.build or self.estimator)

    @property
    def takes_file(self) -> bool:
        """Whether "NAME:FILE" says more than NAME."""
        return "file" in self.takes

    def settings(self, given: Mapping[str, Any]) -> Any:
        """The estimator for a run, given a value of each of `SETTINGS`; None where these leave it out."""
        return import_name(self.build or self.estimator)(**{name: given[name] for name in self.takes})

    def from_dict(self, document: Mapping[str, Any]) -> Any:
        """The fitted model that a document of `to_dict()` holds."""
        return import_name(self.rebuild)(document)
