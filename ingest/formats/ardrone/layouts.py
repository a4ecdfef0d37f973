"""The options of an AR.Drone navdata packet: names, fields, units.

Layouts as the AR.Drone SDK 2.0 declares them (navdata_common.h, packed, little-endian), without the four
bytes of tag and size. `scale` takes a raw value to `unit`. Only options that carry flight data are listed;
video, games and the like are stepped over.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

CHECKSUM_TAG = 0xFFFF
NAVDATA_PORT = 5554
AT_PORT = 5556


@dataclass(frozen=True)
class OptionField:
    """One field: NumPy type, number of elements (0: one), unit after scaling, scale, names of its values."""

    name: str
    dtype: str
    count: int = 0
    unit: str = ""
    scale: float = 1.0
    enum: Mapping[int, str] | None = None


@dataclass(frozen=True, eq=False)
class Option:
    """An option's stream name and its fields, one after the other."""

    name: str
    fields: tuple[OptionField, ...]

    def dtype(self) -> np.dtype[np.void]:
        return np.dtype(
            [(f.name, f.dtype, (f.count,)) if f.count else (f.name, f.dtype) for f in self.fields]
        )


def _all(names: str, dtype: str, unit: str = "", scale: float = 1.0) -> tuple[OptionField, ...]:
    return tuple(OptionField(name, dtype, 0, unit, scale) for name in names.split())


F4 = "<f4"
I4 = "<i4"
U4 = "<u4"
U2 = "<u2"
I2 = "<i2"
U1 = "u1"
F8 = "<f8"
FLY_STATES = dict(
    enumerate(["OK", "LOST_ALT", "LOST_ALT_GO_DOWN", "ALT_OUT_ZONE", "COMBINED_YAW", "BRAKE", "NO_VISION"])
)
CONTROL_STATES = {
    0: "DEFAULT",
    1: "INIT",
    2: "LANDED",
    3: "FLYING",
    4: "HOVERING",
    5: "TEST",
    6: "TRANS_TAKEOFF",
    7: "TRANS_GOTOFIX",
    8: "TRANS_LANDING",
    9: "TRANS_LOOPING",
}
MILLIDEGREE = ("deg", 1e-3)
MILLIMETRE = ("m", 1e-3)

DEMO = Option(
    "demo",
    (
        OptionField("fly_state", U2, enum=FLY_STATES),
        OptionField("ctrl_state", U2, enum=CONTROL_STATES),
        OptionField("vbat_flying_percentage", U4, 0, "%"),
        *_all("theta phi psi", F4, *MILLIDEGREE),
        OptionField("altitude", I4, 0, *MILLIMETRE),
        *_all("vx vy vz", F4, "m/s", 1e-3),
        OptionField("num_frames", U4),
        OptionField("detection_camera_rot", F4, 9),
        OptionField("detection_camera_trans", F4, 3),
        *_all("detection_tag_index detection_camera_type", U4),
        OptionField("drone_camera_rot", F4, 9),
        OptionField("drone_camera_trans", F4, 3),
    ),
)
RAW_MEASURES = Option(
    "raw_measures",
    (
        OptionField("raw_accs", U2, 3),
        OptionField("raw_gyros", I2, 3),
        OptionField("raw_gyros_110", I2, 2),
        OptionField("vbat_raw", U4, 0, "mV"),
        *_all("us_debut_echo us_fin_echo us_association_echo us_distance_echo us_courbe_temps", U2),
        *_all("us_courbe_valeur us_courbe_ref flag_echo_ini nb_echo", U2),
        OptionField("sum_echo", U4),
        OptionField("alt_temp_raw", I4, 0, *MILLIMETRE),
        OptionField("gradient", I2),
    ),
)
PHYS_MEASURES = Option(
    "phys_measures",
    (
        OptionField("accs_temp", F4, 0, "degC"),
        OptionField("gyro_temp", U2),
        OptionField("phys_accs", F4, 3, "mgn"),
        OptionField("phys_gyros", F4, 3, "deg/s"),
        *_all("alim3V3 vrefEpson vrefIDG", U4),
    ),
)
REFERENCES = Option(
    "references",
    (
        *_all("ref_theta ref_phi ref_theta_I ref_phi_I ref_pitch ref_roll", I4, *MILLIDEGREE),
        OptionField("ref_yaw", I4, 0, "deg/s", 1e-3),
        OptionField("ref_psi", I4, 0, *MILLIDEGREE),
        *_all("vx_ref vy_ref", F4, "m/s", 1e-3),
        *_all("theta_mod phi_mod k_v_x k_v_y", F4),
        OptionField("k_mode", U4),
        *_all("ui_time ui_theta ui_phi ui_psi ui_psi_accuracy", F4),
        OptionField("ui_seq", I4),
    ),
)
PWM = Option(
    "pwm",
    (
        *_all("motor1 motor2 motor3 motor4 sat_motor1 sat_motor2 sat_motor3 sat_motor4", U1),
        *_all("gaz_feed_forward gaz_altitude altitude_integral", F4),
        OptionField("vz_ref", F4, 0, "m/s", 1e-3),
        *_all("u_pitch u_roll u_yaw", I4),
        OptionField("yaw_u_I", F4),
        *_all("u_pitch_planif u_roll_planif u_yaw_planif", I4),
        OptionField("u_gaz_planif", F4),
        *_all("current_motor1 current_motor2 current_motor3 current_motor4", U2, "mA"),
        *_all("altitude_prop altitude_der", F4),
    ),
)
ALTITUDE = Option(
    "altitude",
    (
        OptionField("altitude_vision", I4, 0, *MILLIMETRE),
        OptionField("altitude_vz", F4, 0, "m/s", 1e-3),
        *_all("altitude_ref altitude_raw", I4, *MILLIMETRE),
        *_all("obs_accZ obs_alt", F4),
        OptionField("obs_x", F4, 3),
        OptionField("obs_state", U4),
        OptionField("est_vb", F4, 2),
        OptionField("est_state", U4),
    ),
)
VISION = Option(
    "vision",
    (
        OptionField("vision_state", U4),
        OptionField("misc", I4),
        *_all("phi_trim phi_ref_proj theta_trim theta_ref_proj", F4, "rad"),
        OptionField("new_raw_picture", I4),
        *_all("theta_capture phi_capture psi_capture", F4, "rad"),
        OptionField("altitude_capture", I4, 0, *MILLIMETRE),
        OptionField("time_capture", U4),
        *_all("body_v_x body_v_y body_v_z", F4, "m/s", 1e-3),
        *_all("delta_phi delta_theta delta_psi", F4),
        *_all("gold_defined gold_reset", U4),
        *_all("gold_x gold_y", F4),
    ),
)
MAGNETO = Option(
    "magneto",
    (
        *_all("mx my mz", I2),
        *(OptionField(name, F4, 3) for name in ("magneto_raw", "magneto_rectified", "magneto_offset")),
        *_all("heading_unwrapped heading_gyro_unwrapped heading_fusion_unwrapped", F4, "deg"),
        OptionField("magneto_calibration_ok", U1),
        OptionField("magneto_state", U4),
        *_all("magneto_radius error_mean error_var", F4),
    ),
)
KALMAN_PRESSURE = Option(
    "kalman_pressure",
    (
        *_all("offset_pressure est_z est_zdot est_bias_PWM est_biais_pression offset_US", F4),
        *_all("prediction_US cov_alt cov_PWM cov_vitesse", F4),
        OptionField("bool_effet_sol", I4),
        OptionField("somme_inno", F4),
        OptionField("flag_rejet_US", I4),
        *_all("u_multisinus gaz_altitude", F4),
        *_all("flag_multisinus flag_multisinus_debut", I4),
    ),
)
GPS = Option(
    "gps",
    (
        *_all("latitude longitude", F8, "deg"),
        OptionField("elevation", F8, 0, "m"),
        OptionField("hdop", F8),
        *_all("data_available zero_validated wpt_validated", I4),
        *_all("lat0 long0 lat_fused long_fused", F8, "deg"),
        OptionField("gps_state", U4),
        *_all("X_traj X_ref Y_traj Y_ref theta_p phi_p theta_i phi_i theta_d phi_d", F4),
        *_all("vdop pdop", F8),
        OptionField("speed", F4, 0, "m/s"),
        OptionField("last_frame_timestamp", U4),
        *_all("degree degree_mag ehpe ehve c_n0", F4),
        OptionField("nbsat", U4),
        OptionField("channels", U1, 24),
        OptionField("is_gps_plugged", I4),
        OptionField("ephemeris_status", U4),
        *_all("vx_traj vy_traj", F4),
        OptionField("firmware_status", U4),
    ),
)

OPTIONS: Mapping[int, Option] = {
    0: DEMO,
    1: Option("time", (OptionField("time", U4),)),
    2: RAW_MEASURES,
    3: PHYS_MEASURES,
    4: Option("gyros_offsets", (OptionField("offset_g", F4, 3),)),
    5: Option("euler_angles", _all("theta_a phi_a", F4, *MILLIDEGREE)),
    6: REFERENCES,
    7: Option("trims", _all("angular_rates_trim_r euler_angles_trim_theta euler_angles_trim_phi", F4)),
    8: Option("rc_references", _all("rc_ref_pitch rc_ref_roll rc_ref_yaw rc_ref_gaz rc_ref_ag", I4)),
    9: PWM,
    10: ALTITUDE,
    11: Option("vision_raw", _all("vision_tx_raw vision_ty_raw vision_tz_raw", F4)),
    12: Option("vision_of", (OptionField("of_dx", F4, 5), OptionField("of_dy", F4, 5))),
    13: VISION,
    17: Option("watchdog", (OptionField("watchdog", I4),)),
    21: Option(
        "pressure_raw",
        (
            OptionField("up", I4),
            OptionField("ut", I2),
            OptionField("temperature_meas", I4, 0, "degC", 0.1),
            OptionField("pression_meas", I4, 0, "Pa"),
        ),
    ),
    22: MAGNETO,
    23: Option(
        "wind_speed",
        (
            OptionField("wind_speed", F4, 0, "m/s"),
            *_all("wind_angle wind_compensation_theta wind_compensation_phi", F4),
            *_all("state_x1 state_x2 state_x3 state_x4 state_x5 state_x6", F4),
            *_all("magneto_debug1 magneto_debug2 magneto_debug3", F4),
        ),
    ),
    24: KALMAN_PRESSURE,
    26: Option("wifi", (OptionField("link_quality", U4),)),
    27: GPS,
}
ZIMMU_3000 = Option("zimmu_3000", (OptionField("vzimmuLSB", I4), OptionField("vzfind", F4)))
NOT_FLIGHT_DATA = frozenset({14, 15, 16, 18, 19, 20, 25})


def option_of(tag: int, size: int) -> Option | None:
    """The option of a tag whose body has `size` bytes; None where it has none of ours or is too short.

    Later firmware appends fields: a longer body is read as far as it is known. Tag 27 was another sensor
    once.
    """
    if tag == 27 and size == 8:
        return ZIMMU_3000
    option = OPTIONS.get(tag)
    return option if option is not None and option.dtype().itemsize <= size else None
