"""What a fitted model may offer beyond the laws of `flysid.model.base`.

Whoever shows or judges models asks for these capabilities, never for a type: a new structure is served in
every report by offering what it has.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from flysid.dataset import Dataset, FloatArray
from flysid.model.base import Fitted, OperatingPoint
from flysid.model.polynomials import ComplexArray


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Response of a linear model.

    Attributes
    ----------
    omega : (M,) rad/s.
    response : (M, n_y, n_u) complex.
    magnitude_error, phase_error : (M, n_y, n_u) standard errors of |G| and of its phase in rad (first order);
        NaN where they are not known.
    """

    omega: FloatArray
    response: ComplexArray
    magnitude_error: FloatArray
    phase_error: FloatArray


@runtime_checkable
class HasCheck(Protocol):
    """Settings of a model that can say before any data are there that they cannot be."""

    def check_settings(self) -> None:
        """Raise UsageError for a setting, or a file, that cannot be, whatever the data."""
        ...


@dataclass(frozen=True)
class Coefficient:
    """One estimated number of one equation.

    Attributes
    ----------
    rule : "R1", or "" in a linear model.
    output : whose equation it is.
    regressor : what it multiplies, "theta(k-1)".
    value : in units of the output per unit of the regressor.
    half_width : of its 95 % interval.
    """

    rule: str
    output: str
    regressor: str
    value: float
    half_width: float


@runtime_checkable
class LinearModel(Fitted, Protocol):
    """A model of one rule that always holds."""

    @property
    def poles(self) -> ComplexArray:
        """Poles in z, slowest first."""
        ...

    @property
    def is_stable(self) -> bool:
        """Every pole lies inside the unit circle."""
        ...

    @property
    def dc_gain(self) -> FloatArray:
        """(n_y, n_u) steady gain; NaN where the model integrates."""
        ...

    def frequency_response(self, omega: FloatArray) -> FrequencyResponse:
        """G(e^(i omega dt)) with first-order standard errors.

        Raises
        ------
        UsageError : a frequency beyond the Nyquist frequency.
        """
        ...

    def simulation_band(
        self, u: FloatArray, y0: FloatArray | None = None, *, draws: int = 200, seed: int = 0
    ) -> tuple[FloatArray, FloatArray]:
        """(lower, upper), (N, n_y) each: pointwise 95 % band of the free run, the parameters being unsure.

        Raises
        ------
        UsageError : the model carries no covariance, or nearly every draw is unstable.
        """
        ...

    def to_control(self) -> Any:
        """A discrete python-control system with named inputs and outputs; offsets are left out."""
        ...


@runtime_checkable
class HasDraws(Protocol):
    """A linear model that can be drawn from the distribution of its numbers."""

    def draws(self, count: int = 200, seed: int = 0) -> Sequence[Fitted]:
        """Models like it, the same for the same seed; some may be unstable.

        Raises
        ------
        UsageError : the model carries no covariance.
        """
        ...


@runtime_checkable
class HasCoefficients(Protocol):
    """A linear model whose coefficients mean something by themselves."""

    def coefficients(self) -> Sequence[Coefficient]:
        """Every estimated one; none where the model carries no covariance."""
        ...


class TransferFunction(Protocol):
    """numerator(s) / denominator(s) exp(-dead_time_s s), from one input to one output."""

    @property
    def input(self) -> str: ...
    @property
    def output(self) -> str: ...
    @property
    def numerator(self) -> FloatArray: ...
    @property
    def denominator(self) -> FloatArray: ...
    @property
    def dead_time_s(self) -> float: ...
    @property
    def gain(self) -> Any: ...
    @property
    def dead_time(self) -> Any: ...


@runtime_checkable
class HasTransferFunctions(Protocol):
    """A linear model that knows its transfer functions in s, with intervals."""

    @property
    def transfers(self) -> Sequence[TransferFunction]:
        """One per output and input, outputs outermost."""
        ...

    def transfer(self, output: int = 0, source: int = 0) -> TransferFunction:
        """From one input to one output."""
        ...


@runtime_checkable
class HasOtherRates(Protocol):
    """A model that can be sampled at another rate than the one that it was fitted at."""

    def at_rate(self, rate_hz: float) -> Fitted:
        """The model at so many steps a second, its inputs constant between samples.

        Raises
        ------
        UsageError : it drifts by itself.
        """
        ...


@runtime_checkable
class HasMembers(Fitted, Protocol):
    """A model that answers with the mean of others."""

    @property
    def members(self) -> tuple[Fitted, ...]:
        """Models of the same signals, at least two."""
        ...


class DifferenceEquation(Protocol):
    """sum_k a[k] y(t - k) = sum_k b[k] u(t - k) + constant, with a[0] the identity."""

    @property
    def a(self) -> FloatArray: ...
    @property
    def b(self) -> FloatArray: ...


@runtime_checkable
class HasDifferenceEquation(Protocol):
    """A linear model that offers its difference equation."""

    @property
    def system(self) -> DifferenceEquation: ...


class StateMatrices(Protocol):
    """x(k+1) = a x + b u, y = c x + d u."""

    @property
    def a(self) -> FloatArray: ...
    @property
    def b(self) -> FloatArray: ...
    @property
    def c(self) -> FloatArray: ...
    @property
    def d(self) -> FloatArray: ...


@runtime_checkable
class HasRealisation(Protocol):
    """A linear model that offers its state-space matrices."""

    @property
    def realisation(self) -> StateMatrices: ...


@runtime_checkable
class DeviationEquation(Fitted, Protocol):
    """A difference equation of deviations from the training means: what other programs are given."""

    @property
    def system(self) -> Any:
        """`DifferenceEquation`, with the constant `c` and whether it `is_diagonal`."""
        ...

    @property
    def noise(self) -> FloatArray | None:
        """(p + 1, n_y) monic autoregression of the simulation error, or None."""
        ...

    @property
    def u_origin(self) -> FloatArray: ...
    @property
    def y_origin(self) -> FloatArray: ...


@runtime_checkable
class DeviationStates(Fitted, Protocol):
    """A state space of deviations from the training means: what other programs are given."""

    @property
    def realisation(self) -> Any:
        """`StateMatrices`, with the filter's gain `k` and the constant `level`."""
        ...

    @property
    def delays(self) -> tuple[int, ...]:
        """Samples by which every input is late; () for none."""
        ...

    @property
    def u_origin(self) -> FloatArray: ...
    @property
    def y_origin(self) -> FloatArray: ...


@runtime_checkable
class HasRuleRecursion(Fitted, Protocol):
    """Rules whose free run the compiled kernel computes (`flysid.model.rules.kernel`)."""

    @property
    def layout(self) -> Any:
        """Lags, scales and hidden states (`flysid.model.rules.regressor_layout.Layout`)."""
        ...

    @property
    def free(self) -> Any:
        """Numbers of the kernel's free run."""
        ...

    def run(self, u: FloatArray, y0: FloatArray) -> FloatArray:
        """(N, columns of the layout) a free run, hidden states among its columns."""
        ...


@runtime_checkable
class HasExplanation(Protocol):
    """A model that can say why it predicts what it does."""

    def explain(self, u: FloatArray, y: FloatArray, row: int) -> Any:
        """What every rule said at one row, and on what ground; `str` of it is for people."""
        ...


@runtime_checkable
class LocallyLinear(Protocol):
    """A model whose rules are difference equations."""

    def local_polynomials(self) -> tuple[tuple[FloatArray, FloatArray, FloatArray], ...]:
        """Per rule (A, B, c): y(k) = sum_j A[j-1] y(k-j) + sum_j B[j] u(k-j) + c, physical units;
        A (na, n_y, n_y), B (largest lag + 1, n_y, n_u), c (n_y,)."""
        ...


class Certificate(Protocol):
    """What could be proved about a model's stability, and why or why not in words."""

    @property
    def proved(self) -> bool: ...
    @property
    def reason(self) -> str: ...


class Simplification(Protocol):
    """A model with fewer words, and what that costs its free run."""

    @property
    def what(self) -> str: ...
    @property
    def loss_pct(self) -> float: ...


@runtime_checkable
class HasIntervals(Protocol):
    """A model of rules that can say how sure it is of its numbers, beside its training data."""

    def uncertainty(self, train: Dataset) -> Any:
        """The distribution of its numbers: consequents, gains, time constants, the free run's band.

        Raises
        ------
        DataError : fewer samples than numbers.
        """
        ...


@runtime_checkable
class HasOperatingPoints(Protocol):
    """A model of rules that knows what it does where its vehicle rests."""

    @property
    def operating_points(self) -> Sequence[OperatingPoint]: ...


@runtime_checkable
class HasCertificate(Protocol):
    """A model of rules whose stability under any blend can be looked for."""

    def certificate(self) -> Certificate: ...


@runtime_checkable
class HasSimplifications(Protocol):
    """A model of rules that has simpler forms."""

    def simplifications(self, train: Dataset) -> Sequence[Simplification]:
        """Simpler forms, cheapest first."""
        ...


@runtime_checkable
class HasMemberships(Protocol):
    """A model that can draw its fuzzy sets."""

    @property
    def antecedents(self) -> tuple[str, ...]:
        """Antecedent variables, such as "v_x(k-1)" or "v_x(k-1)-v_x(k-2)"."""
        ...

    def memberships(self, variable: int, x: FloatArray) -> FloatArray:
        """(len(x), R) grade of the values x of one variable in every rule's set."""
        ...


@runtime_checkable
class HasRuleOutputs(Protocol):
    """A model that can say what every rule concludes by itself."""

    def rule_outputs(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, R, n_y) along measured data."""
        ...


@runtime_checkable
class HasTrainedRange(Protocol):
    """A model that knows where its antecedents were in training; hidden states are in no record."""

    @property
    def trained_range(self) -> FloatArray:
        """(2, n_z) smallest and largest values."""
        ...
