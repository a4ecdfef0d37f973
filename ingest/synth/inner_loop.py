"""The manufacturer's inner loop: theta_in, phi_in, vz_in and yaw rate to rotor speeds; the paper's figure 3.

The firmware is closed; what is known of it is that (10), (11) and (12) describe small motions. So its
structure is assumed, and its gains are tuned (`tuning`) until the linearised loop agrees with them:

- a tilt command is limited, shaped by a first-order lag and followed by the attitude loop;
- a velocity assist leans against the motion, as firmware with optical flow does: (10) needs a damping of
  1.8 1/s, air drag supplies 0.3. Its authority is limited (`assist_max_rad`), so fast flight answers with
  more gain;
- (11) has a slow pole and zero near 0.5 rad/s: a leaky integral of the velocity belongs to its assist;
- the climb loop follows (12) as its reference model, with proportional and integral correction and a lead
  against the motors' lag.
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Axis:
    """One tilt axis.

    `gain`: tilt reference per commanded tilt.
    `lag_s`: of the command shaping.
    `kp`: assist per velocity, rad per m/s.
    `ki`, `leak_1_s`: slow assist, rad per m; its leak.
    """

    gain: float
    lag_s: float
    kp: float
    ki: float = 0.0
    leak_1_s: float = 1.0


@dataclass(frozen=True)
class InnerLoop:
    """Gains of the inner loop, tuned by `flysid.ingest.synth.tuning`; limits are the firmware's settings.

    `tilt_max_rad` is euler_angle_max, `climb_max_m_s` is control_vz_max, both as the factory sets them.
    """

    pitch: Axis = field(default_factory=lambda: Axis(1.16331, 0.257943, 0.151522))
    roll: Axis = field(default_factory=lambda: Axis(0.689570, 0.02, 0.0151495, 0.00365680, 0.409313))
    assist_max_rad: float = 0.08
    tilt_max_rad: float = 0.209
    climb_max_m_s: float = 0.7
    attitude_rad_s: float = 18.0
    attitude_damping: float = 0.9
    yaw_1_s: float = 4.0
    climb_kp: float = 4.0
    climb_ki: float = 2.0
    climb_i_max: float = 2.0
    climb_lead_s: float = 0.03
