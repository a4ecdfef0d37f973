"""An FMU for co-simulation as a simulator, run by FMPy (`flysid[fmu]`).

An FMU is a program: it is run because the user has named it. The convention of samples is that of
`flysid.export.fmu`: set u(k), read y(k), step to k + 1.
"""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.errors import UsageError
from flysid.outside.like import Like, Matched, match
from flysid.outside.simulator import Simulated, running

SETTABLE = ("local", "output")


@dataclass(frozen=True, eq=False)
class FmuSimulator:
    """An unpacked FMU: one fresh instance a run."""

    name: str
    description: Any
    folder: str
    dt_s: float
    start: FloatArray
    starts: tuple[int, ...]
    u_places: tuple[int, ...]
    y_places: tuple[int, ...]

    starts_at_outputs = False

    @property
    def words(self) -> str:
        """ "the FMU plant.fmu"."""
        return f"the FMU {self.name}"

    def run(self, u: FloatArray, start: FloatArray) -> FloatArray:
        """(N, n_y) outputs. Raises UsageError: the FMU fails."""
        with running(self.words):
            return self._run(u, start)

    def _run(self, u: FloatArray, start: FloatArray) -> FloatArray:
        from fmpy import instantiate_fmu

        slave = instantiate_fmu(self.folder, self.description, "CoSimulation")
        newer = self.description.fmiVersion.startswith("3")
        put = slave.setFloat64 if newer else slave.setReal
        get = slave.getFloat64 if newer else slave.getReal
        out = np.empty((len(u), len(self.y_places)))
        try:
            if newer:
                slave.enterInitializationMode(startTime=0.0)
            else:
                slave.setupExperiment(startTime=0.0)
                slave.enterInitializationMode()
            if self.starts:
                put(self.starts, [float(x) for x in start])
            if self.u_places and len(u):
                put(self.u_places, [float(x) for x in u[0]])
            slave.exitInitializationMode()
            for k in range(len(u)):
                if self.u_places:
                    put(self.u_places, [float(x) for x in u[k]])
                out[k] = get(self.y_places)
                if k + 1 < len(u):
                    slave.doStep(currentCommunicationPoint=k * self.dt_s, communicationStepSize=self.dt_s)
            slave.terminate()
        finally:
            slave.freeInstance()
        return out


def fmu_model(path: Path, like: Like, starts: Sequence[str] = ()) -> Simulated:
    """Unpack an FMU and match its signals.

    `starts`: variables that a run starts from, besides those that the FMU declares so (initial "exact").
    Raises UsageError: no FMPy, not an FMU for co-simulation on this machine, other signals, units or sample
    time.
    """
    described = _description(path)
    _refuse_other_steps(described, like.dt_s, path)
    floats = [v for v in described.modelVariables if v.type in ("Real", "Float64") and not v.dimensions]
    ins, u_places = _side(floats, like.inputs, "input", path)
    outs, y_places = _side(floats, like.outputs, "output", path)
    begins = [v for v in floats if _starts(v) or v.name in starts]
    lost = sorted(set(starts) - {v.name for v in begins})
    if lost:
        raise UsageError(
            f"the FMU has no real variable {', '.join(lost)}",
            path=path,
            hint="its modelDescription.xml names them",
        )
    from fmpy import extract

    folder = tempfile.mkdtemp(prefix="flysid-fmu-")
    extract(str(path), folder)
    simulator = FmuSimulator(
        name=path.name,
        description=described,
        folder=folder,
        dt_s=like.dt_s,
        start=np.array([float(v.start or 0.0) for v in begins]),
        starts=tuple(v.valueReference for v in begins),
        u_places=u_places,
        y_places=y_places,
    )
    weakref.finalize(simulator, shutil.rmtree, folder, ignore_errors=True)
    about = ", ".join(v.name for v in begins)
    began = (
        f"A free run starts from {about}, fitted to the measured window."
        if begins
        else "It declares no initial states: every free run starts from the FMU's own."
    )
    return Simulated(
        dt_s=like.dt_s,
        inputs=like.inputs,
        outputs=like.outputs,
        simulator=simulator,
        u_factors=ins.factors,
        y_factors=outs.factors,
        notes=(f"The FMU {path.name}; nothing was estimated.", began, *ins.notes, *outs.notes),
    )


def _description(path: Path) -> Any:
    """Read the FMU's description; UsageError where it cannot be run here."""
    try:
        import fmpy
    except ImportError as error:
        raise UsageError("FMPy is needed for FMUs", hint="pip install 'flysid[fmu]'") from error
    try:
        described = fmpy.read_model_description(str(path))
        platforms = fmpy.supported_platforms(str(path))
    except Exception as error:  # somebody else's archive
        raise UsageError(f"not an FMU: {error}"[:200], path=path) from error
    if described.coSimulation is None:
        raise UsageError("an FMU for model exchange", path=path, hint="export it for co-simulation")
    here = fmpy.platform if described.fmiVersion.startswith("2") else fmpy.platform_tuple
    if here not in platforms and fmpy.platform not in platforms:
        raise UsageError(
            f"it holds no binary for {here}, but for {', '.join(platforms) or 'none'}",
            path=path,
            hint="build it for this machine, from its sources if it has them",
        )
    return described


def _refuse_other_steps(described: Any, dt_s: float, path: Path) -> None:
    """UsageError unless the data's sample time is a whole number of the FMU's steps, or it takes any."""
    step = described.defaultExperiment.stepSize if described.defaultExperiment is not None else None
    if step is None or described.coSimulation.canHandleVariableCommunicationStepSize is True:
        return
    ratio = dt_s / float(step)
    if abs(ratio - round(ratio)) > 1e-6 or round(ratio) < 1:
        raise UsageError(
            f"the FMU steps by {float(step):g} s, the data by {dt_s:g} s",
            path=path,
            hint="export it with the data's step, or a whole fraction of it",
        )


def _side(
    floats: Sequence[Any], ours: Sequence[Signal], side: str, path: Path
) -> tuple[Matched, tuple[int, ...]]:
    """The FMU's inputs or outputs that the data's signals are, and their value references."""
    found = [v for v in floats if v.causality == side]
    names = [v.name for v in found]
    missing = [s.name for s in ours if s.name not in names]
    if missing and len(found) != len(ours):
        raise UsageError(
            f"the FMU has no {side} {', '.join(missing)}, but {', '.join(names)}",
            path=path,
            hint=f"name its {side}s as the data do",
        )
    used = found if missing else [found[names.index(s.name)] for s in ours]
    own = match(ours, [v.name for v in used], [_unit(v) for v in used], side)
    return own, tuple(used[j].valueReference for j in own.order)


def _unit(variable: Any) -> str:
    declared = variable.declaredType
    return str(variable.unit or (declared.unit if declared is not None else None) or "")


def _starts(variable: Any) -> bool:
    """Whether the FMU declares that a run starts from it."""
    return (
        variable.initial == "exact" and variable.causality in SETTABLE and variable.variability != "constant"
    )
