"""JSBSim: an aircraft's file whose rotors, drag and torques are functions of its own properties.

Commands are `fcs/motor1-cmd-norm` ..., shares of full scale from 0 to 1. Delay, lag, curve and every force
and torque of the vehicle are in the file. JSBSim adds the turning, round earth and its gravity. Set its time
step before it loads the file: it works out its filters then.
"""

from __future__ import annotations

from collections.abc import Sequence
from xml.sax.saxutils import quoteattr

from flysid.export.vehicles.body import ARM_M, MASS_KG, Body, body_of
from flysid.sixdof import layout
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.layout import ARM, CURVE, DAMPING, DELAY, INERTIA, LAG, ROTOR_DRAG, THRUST

_FOOT_M = 0.3048
_POUND_N = 4.4482216152605
_LEAST_SHARE = 1e-9

Term = str | float


def _term(value: Term) -> str:
    if isinstance(value, float):
        return f"<value>{value!r}</value>"
    return value if value.startswith("<") else f"<property>{value}</property>"


def _joined(kind: str, terms: Sequence[Term]) -> str:
    return f"<{kind}>{''.join(map(_term, terms))}</{kind}>"


def _product(*terms: Term) -> str:
    return _joined("product", terms)


def _sum(*terms: Term) -> str:
    return _joined("sum", terms)


def _function(name: str, body: str) -> str:
    return f'    <function name="vehicle/{name}">{body}</function>\n'


_AIR = ("vehicle/air-x", "vehicle/air-y", "vehicle/air-z")
_RATES = ("vehicle/rate-x", "vehicle/rate-y", "vehicle/rate-z")
_AXES = ("X", "Y", "Z", "ROLL", "PITCH", "YAW")
_WAYS = (1.0, -1.0, -1.0)
"""From forward, left, up to forward, right, down."""


def jsbsim_aircraft(vehicle: FittedVehicle, name: str, mass_kg: float = MASS_KG, arm_m: float = ARM_M) -> str:
    """The aircraft's file, as text; raises as `body_of`."""
    body = body_of(vehicle, mass_kg, arm_m)
    motors = range(vehicle.motors)
    inertia = "".join(
        f'    <i{axis} unit="KG*M2">{moment:.12g}</i{axis}>\n'
        for axis, moment in zip(("xx", "yy", "zz"), body.inertia.tolist(), strict=True)
    )
    places = "".join(
        f'    <location name="{point}" unit="M"><x>0</x><y>0</y><z>0</z></location>\n'
        for point in ("AERORP", "EYEPOINT", "VRP")
    )
    return (
        '<?xml version="1.0"?>\n'
        f'<fdm_config name={quoteattr(name)} version="2.0" release="BETA">\n'
        "  <fileheader><author>flysid</author><description>A vehicle identified from flights; "
        f"mass {mass_kg:g} kg, arm {arm_m:g} m</description></fileheader>\n"
        '  <metrics>\n    <wingarea unit="M2">1</wingarea><wingspan unit="M">1</wingspan>'
        f'<chord unit="M">1</chord>\n{places}  </metrics>\n'
        f'  <mass_balance>\n{inertia}    <emptywt unit="KG">{body.mass_kg!r}</emptywt>\n'
        '    <location name="CG" unit="M"><x>0</x><y>0</y><z>0</z></location>\n  </mass_balance>\n'
        "  <ground_reactions/>\n"
        f'  <system name="motors">\n{"".join(_motor(vehicle, i) for i in motors)}  </system>\n'
        f"  <aerodynamics>\n{_shared(vehicle)}{_forces(body)}{_torques(vehicle, body)}"
        "  </aerodynamics>\n</fdm_config>\n"
    )


def _motor(vehicle: FittedVehicle, i: int) -> str:
    """Delay, lag, and the share of full thrust."""
    own = f"fcs/motor{i + 1}"
    lag = 1.0 / float(vehicle.theta[LAG])
    curve = float(vehicle.theta[CURVE])
    delay = float(vehicle.theta[DELAY])
    late = f'<delay type="time">{delay!r}</delay>' if delay > 0.0 else ""
    command = f"{own}-after-lag"
    share = _sum(_product(1.0 - curve, command), _product(curve, command, command))
    return (
        f"    <property>{own}-cmd-norm</property>\n"
        f'    <channel name="motor {i + 1}">\n'
        f'      <actuator name="{own}-delayed"><input>{own}-cmd-norm</input>{late}</actuator>\n'
        f'      <lag_filter name="{command}"><input>{own}-delayed</input><c1>{lag!r}</c1></lag_filter>\n'
        f'      <fcs_function name="{own}-share"><function>{share}</function></fcs_function>\n'
        "    </channel>\n"
    )


def _share(i: int) -> str:
    return f"fcs/motor{i + 1}-share"


def _root(i: int) -> str:
    return f"vehicle/root{i + 1}"


def _shared(vehicle: FittedVehicle) -> str:
    """Air speed and rates forward, left, up in SI units; rotor speeds and their sums."""
    motors = range(vehicle.motors)
    feet = ("velocities/u-aero-fps", "velocities/v-aero-fps", "velocities/w-aero-fps")
    turns = ("velocities/p-rad_sec", "velocities/q-rad_sec", "velocities/r-rad_sec")
    rows = []
    for own, foot, rate, turn, way in zip(_AIR, feet, _RATES, turns, _WAYS, strict=True):
        rows.append(_function(own.split("/")[1], _product(way * _FOOT_M, foot)))
        rows.append(_function(rate.split("/")[1], _product(way, turn)))
    squares = [_product(own, own) for own in _AIR]
    rows.append(_function("speed", f"<sqrt>{_sum(*squares)}</sqrt>"))
    for i in motors:
        least = _joined("max", [_share(i), _LEAST_SHARE])
        rows.append(_function(f"root{i + 1}", f"<sqrt>{least}</sqrt>"))
    rows.append(_function("spin", _sum(0.0, *(_root(i) for i in motors))))
    theta = vehicle.theta
    across, along, _ = layout.effects(theta).tolist()
    pitch = float(theta[INERTIA])
    per = 1.0 / float(theta[THRUST])
    hubs = (("hub-roll", across), ("hub-pitch", along))
    for label, effects in hubs:
        terms = [_product(per * effects[i], _root(i)) for i in motors]
        rows.append(_function(label, _sum(0.0, *terms)))
    sums = (
        ("met-roll", [a * a for a in across]),
        ("met-both", [a * pitch * b for a, b in zip(across, along, strict=True)]),
        ("met-pitch", [(pitch * b) ** 2 for b in along]),
    )
    gain = float(theta[ARM]) * per
    for label, weights in sums:
        terms = [_product(gain * weights[i], _root(i)) for i in motors]
        rows.append(_function(label, _sum(0.0, *terms)))
    return "".join(rows)


def _axis(place: int, terms: Sequence[str], unit: float) -> str:
    """A force or torque about one of JSBSim's axes, from newtons (and metres)."""
    whole = _product(_WAYS[place % 3] / unit, _sum(0.0, *terms))
    kind = "force" if place < 3 else "torque"
    letter = "xyz"[place % 3]
    return (
        f'    <axis name="{_AXES[place]}"><function name="aero/{kind}/{letter}">{whole}</function></axis>\n'
    )


def _forces(body: Body) -> str:
    rows = []
    for k in range(3):
        drag = _sum(
            _product(float(body.rotor_drag[k]), "vehicle/spin"),
            _product(float(body.body_drag[k]), "vehicle/speed"),
        )
        terms = [_product(-1.0, drag, _AIR[k])]
        if k == 2:
            terms += [_product(body.thrust_n, _share(i)) for i in range(len(body.places))]
        rows.append(_axis(k, terms, _POUND_N))
    return "".join(rows)


def _torques(vehicle: FittedVehicle, body: Body) -> str:
    theta = vehicle.theta
    motors = range(vehicle.motors)
    effects = layout.effects(theta).tolist()
    drag = [float(x) for x in theta[ROTOR_DRAG : ROTOR_DRAG + 3]]
    pitch, yaw = (float(x) for x in theta[INERTIA : INERTIA + 2])
    lean = [float(x) for x in theta[layout.LEAN : layout.LEAN + 2]]
    hubs = ("vehicle/hub-roll", "vehicle/hub-pitch")
    own = [
        [
            _product(lean[0], "vehicle/spin", _AIR[1]),
            _product(-drag[2], hubs[0], _AIR[2]),
            _product(-drag[2], "vehicle/met-roll", _RATES[0]),
            _product(-drag[2], "vehicle/met-both", _RATES[1]),
        ],
        [
            _product(lean[1], "vehicle/spin", _AIR[0]),
            _product(-drag[2], hubs[1], _AIR[2]),
            _product(-drag[2] / pitch, "vehicle/met-both", _RATES[0]),
            _product(-drag[2] / pitch, "vehicle/met-pitch", _RATES[1]),
        ],
        [
            _product(drag[1] * pitch / yaw, hubs[1], _AIR[1]),
            _product(drag[0] / yaw, hubs[0], _AIR[0]),
            _product(-drag[0] / yaw, "vehicle/met-roll", _RATES[2]),
            _product(-drag[1] / yaw, "vehicle/met-pitch", _RATES[2]),
        ],
    ]
    rows = []
    for k in range(3):
        terms = [_term(float(theta[layout.TRIM + k])), *own[k]]
        terms.append(_product(-float(theta[DAMPING + k]), "vehicle/spin", _RATES[k]))
        terms += [_product(effects[k][i], _share(i)) for i in motors]
        rows.append(_axis(3 + k, terms, _POUND_N * _FOOT_M / float(body.inertia[k])))
    return "".join(rows)
