"""Public identification benchmarks with their exact splits; read from ../shared/benchmarks, never copied.

The origin of each set and the figures that others published stand in docs/measured/linear.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flysid.dataset import Dataset, FloatArray, Signal

FOLDER = Path(__file__).resolve().parents[2] / "shared" / "benchmarks"


@dataclass(frozen=True)
class Case:
    """A benchmark: what may be learned from, and parts that are opened once.

    Attributes
    ----------
    train, validation : validation is None where the set leaves that choice to the method.
    tests : name -> test data.
    n_init : measured samples that start every test simulation and are left out of its score.
    scale, unit : errors are reported as scale * RMSE in this unit.
    """

    name: str
    train: Dataset
    validation: Dataset | None
    tests: dict[str, Dataset]
    n_init: int
    scale: float
    unit: str


def _data(u: FloatArray, y: FloatArray, dt_s: float, *, unit: str = "") -> Dataset:
    n_u = 1 if u.ndim == 1 else u.shape[1]
    n_y = 1 if y.ndim == 1 else y.shape[1]
    return Dataset.from_arrays(
        u,
        y,
        dt_s,
        inputs=["u"] if n_u == 1 else [f"u{i + 1}" for i in range(n_u)],
        outputs=[Signal("y" if n_y == 1 else f"y{i + 1}", unit) for i in range(n_y)],
    )


def cascaded_tanks() -> Case:
    """Two tanks in cascade with overflow, Ts 4 s."""
    t = np.genfromtxt(FOLDER / "cascaded_tanks.csv", delimiter=",", skip_header=1)
    train = _data(t[:, 0], t[:, 2], 4.0, unit="V")
    return Case("tanks", train, None, {"test": _data(t[:, 1], t[:, 3], 4.0, unit="V")}, 5, 1.0, "V")


def silverbox() -> Case:
    """An electronic Duffing oscillator: multisines train, a growing arrow tests extrapolation."""
    t = np.genfromtxt(FOLDER / "silverbox_snls80mv.csv", delimiter=",", skip_header=1)[:, :2]
    u = t[:, 0]
    y = t[:, 1]
    dt = 1 / 610.35
    cut = 40650 + (127400 - 40650) * 3 // 4
    parts = {
        "multisine": slice(cut, 127400),
        "arrow": slice(100, 40575),
        "no extrapolation": slice(100, 32100),
    }
    train = _data(u[40650:cut], y[40650:cut], dt, unit="V")
    tests = {k: _data(u[s], y[s], dt, unit="V") for k, s in parts.items()}
    return Case("silverbox", train, None, tests, 50, 1000.0, "mV")


def quarter_drone() -> Case:
    """One rotor on an arm, in closed loop, taken at 20 Hz."""

    def part(name: str) -> tuple[FloatArray, FloatArray]:
        t = np.genfromtxt(FOLDER / "quarter_drone" / name, delimiter=",", skip_header=1)[::5]
        return t[:, 3], t[:, 2]

    steps = part("sinal2_degraus_malha_fechada.csv")
    sweep = part("sinal3_swept_sine_malha_fechada.csv")
    signals = {"inputs": ["u"], "outputs": [Signal("angle", "deg")]}
    train = Dataset.from_arrays([steps[0], sweep[0]], [steps[1], sweep[1]], 0.05, **signals)  # type: ignore[arg-type]
    validation = Dataset.from_arrays(
        *part("sinal1_semi_estatica_malha_fechada.csv"),
        0.05,
        **signals,  # type: ignore[arg-type]
    )
    test = Dataset.from_arrays(*part("sinal4_multiseno_malha_fechada.csv"), 0.05, **signals)  # type: ignore[arg-type]
    return Case("quarter-drone", train, validation, {"test": test}, 10, 1.0, "deg")


def emps() -> Case:
    """An electro-mechanical positioning system at 1 kHz: motor voltage to position, with friction."""
    from scipy.io import loadmat

    first, second = (loadmat(FOLDER / f"DATA_EMPS{end}.mat") for end in ("", "_PULSES"))
    data = [_data(m["vir"].ravel(), m["qm"].ravel(), 1e-3, unit="m") for m in (first, second)]
    return Case("emps", data[0], None, {"test": data[1]}, 20, 1000.0, "mm")


def _halves(name: str, t: FloatArray, n_u: int, dt_s: float, cut: int) -> Case:
    first, second = (_data(p[:, :n_u], p[:, n_u:], dt_s) for p in (t[:cut], t[cut:]))
    return Case(name, first, None, {"test": second}, 10, 1.0, "")


def dryer() -> Case:
    """A hair dryer (DaISy)."""
    return _halves("dryer", np.loadtxt(FOLDER / "dryer.dat"), 1, 0.08, 500)


def gas_furnace() -> Case:
    """Box and Jenkins's gas furnace."""
    t = np.genfromtxt(FOLDER / "gas_furnace.csv", delimiter=",", skip_header=1)
    return _halves("gas furnace", t, 1, 9.0, 148)


def robot_arm() -> Case:
    """A flexible robot arm (DaISy)."""
    return _halves("robot arm", np.loadtxt(FOLDER / "robot_arm.dat"), 1, 1.0, 512)


def winding() -> Case:
    """A winding process with five inputs and two outputs (DaISy)."""
    t = np.loadtxt(FOLDER / "winding.dat")
    return _halves("winding", t, 5, 0.1, len(t) // 2)


CASES: dict[str, Callable[[], Case]] = {
    "tanks": cascaded_tanks,
    "quarter-drone": quarter_drone,
    "robot-arm": robot_arm,
    "dryer": dryer,
    "gas-furnace": gas_furnace,
    "winding": winding,
    "emps": emps,
    "silverbox": silverbox,
}
