"""Units of PX4's topics, which ULog does not carry: from PX4's message definitions, in our spelling.

Only what the definitions state. Left out: what changed its unit under one name (`sensor_baro.pressure` was
millibar, gyro_integral_dt seconds), mixed arrays, variances, and normalised values. Names that end in a
unit state it themselves (true_airspeed_m_s), `sensor_combined.gyro_rad` apart.
Source: the .msg files of PX4-Autopilot, msg/ and msg/versioned/, 2016 to 2026.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache, lru_cache

from flysid.ingest.formats.common.table_columns import unit_behind

_TIMES = frozenset({"timestamp", "timestamp_sample", "time_utc_usec", "ref_timestamp"})
_INDEX = re.compile(r"\[\d+\]")
_CAPITAL = re.compile(r"(?<!^)(?=[A-Z])")

# topic -> unit -> fields
_STATED: Mapping[str, Mapping[str, str]] = {
    "airspeed": {"degC": "air_temperature_celsius"},
    "airspeed_validated": {"m/s/s": "airspeed_derivative_filtered", "rad": "pitch_filtered"},
    "airspeed_wind": {"m/s": "windspeed_north windspeed_east tas_innov", "rad": "beta_innov"},
    "battery_status": {
        "V": "voltage_v voltage_filtered_v voltage_cell_v ocv_estimate ocv_estimate_filtered"
        " voltage_prediction prediction_error",
        "A": "current_a current_filtered_a current_average_a average_current_a",
        "mAh": "discharged_mah",
        "Wh": "design_capacity_wh full_charge_capacity_wh remaining_capacity_wh",
        "s": "time_remaining_s",
        "degC": "temperature",
    },
    "control_state": {"rad/s": "roll_rate pitch_rate yaw_rate"},
    "differential_pressure": {
        "Pa": "differential_pressure_pa differential_pressure_raw_pa differential_pressure_filtered_pa",
        "degC": "temperature",
    },
    "distance_sensor": {"m": "min_distance max_distance current_distance", "rad": "h_fov v_fov"},
    "esc_status": {
        "rpm": "esc.esc_rpm",
        "V": "esc.esc_voltage",
        "A": "esc.esc_current",
        "degC": "esc.esc_temperature esc.motor_temperature",
    },
    "estimator_baro_bias": {"m": "bias innov"},
    "estimator_innovations": {
        "m": "gps_hpos gps_vpos ev_hpos ev_vpos fake_hpos fake_vpos rng_vpos baro_vpos hagl",
        "m/s": "gps_hvel gps_vvel ev_hvel ev_vvel fake_hvel fake_vvel aux_hvel aux_vvel airspeed hagl_rate",
        "m/s/s": "drag",
        "rad": "heading beta",
        "rad/s": "flow terr_flow",
        "gauss": "mag_field",
    },
    "estimator_sensor_bias": {"rad/s": "gyro_bias", "m/s/s": "accel_bias", "gauss": "mag_bias"},
    "estimator_status": {"m": "pos_horiz_accuracy pos_vert_accuracy", "s": "time_slip"},
    "home_position": {"deg": "lat lon", "m": "alt x y z", "rad": "roll pitch yaw"},
    "optical_flow": {
        "rad": "pixel_flow_x_integral pixel_flow_y_integral gyro_x_rate_integral gyro_y_rate_integral"
        " gyro_z_rate_integral",
        "us": "integration_timespan time_since_last_sonar_update",
    },
    "position_setpoint_triplet": {
        name: " ".join(
            f"{which}.{field}" for which in ("previous", "current", "next") for field in fields.split()
        )
        for name, fields in (
            ("m/s", "vx vy vz"),
            ("deg", "lat lon"),
            ("m", "alt loiter_radius loiter_minor_radius"),
            ("rad", "yaw loiter_orientation"),
            ("rad/s", "yawspeed"),
        )
    },
    "rate_ctrl_status": {"rad/s": "rollspeed pitchspeed yawspeed"},
    "sensor_accel": {
        "m/s/s": "x y z range_m_s2",
        "m/s": "x_integral y_integral z_integral",
        "degC": "temperature",
    },
    "sensor_baro": {"degC": "temperature"},
    "sensor_combined": {
        "rad/s": "gyro_rad",
        "us": "accelerometer_timestamp_relative magnetometer_timestamp_relative baro_timestamp_relative",
        "gauss": "magnetometer_ga",
        "m": "baro_alt_meter",
        "degC": "baro_temp_celcius",
    },
    "sensor_gps": {
        "degE7": "lat lon",
        "mm": "alt alt_ellipsoid",
        "m": "eph epv",
        "rad": "heading heading_offset heading_accuracy",
        "us": "timestamp_time_relative",
        "Hz": "rtcm_injection_rate",
    },
    "sensor_gyro": {"rad/s": "x y z", "degC": "temperature"},
    "sensor_mag": {"gauss": "x y z", "degC": "temperature"},
    "system_power": {"V": "voltage5v_v voltage5V_v voltage_payload_v voltage3v3_v sensors3v3"},
    "tecs_status": {
        "m": "altitude_sp altitude_sp_filtered",
        "m/s": "height_rate_setpoint height_rate equivalent_airspeed_sp true_airspeed_sp"
        " true_airspeed_filtered",
        "m/s/s": "true_airspeed_derivative_sp true_airspeed_derivative true_airspeed_derivative_raw",
    },
    "trajectory_setpoint": {
        "m": "position x y z",
        "m/s": "velocity vx vy vz",
        "m/s/s": "acceleration",
        "rad": "yaw",
        "rad/s": "yawspeed",
    },
    "vehicle_acceleration": {"m/s/s": "xyz"},
    "vehicle_air_data": {
        "m": "baro_alt_meter",
        "Pa": "baro_pressure_pa",
        "degC": "baro_temp_celcius ambient_temperature",
    },
    "vehicle_angular_acceleration": {"rad/s/s": "xyz"},
    "vehicle_angular_velocity": {"rad/s": "xyz", "rad/s/s": "xyz_derivative"},
    "vehicle_attitude": {"rad/s": "rollspeed pitchspeed yawspeed"},
    "vehicle_attitude_setpoint": {"rad": "roll_body pitch_body yaw_body", "rad/s": "yaw_sp_move_rate"},
    "vehicle_global_position": {"deg": "lat lon", "m": "alt alt_ellipsoid eph epv terrain_alt"},
    "vehicle_imu": {"rad": "delta_angle", "m/s": "delta_velocity", "us": "delta_angle_dt delta_velocity_dt"},
    "vehicle_local_position": {
        "m": "x y z delta_xy delta_z dist_bottom delta_dist_bottom eph epv hagl_min hagl_max hagl_max_z"
        " hagl_max_xy ref_alt",
        "m/s": "vx vy vz z_deriv delta_vxy delta_vz evh evv vxy_max vz_max",
        "m/s/s": "ax ay az",
        "rad": "heading yaw unaided_heading delta_heading",
        "deg": "ref_lat ref_lon",
    },
    "vehicle_magnetometer": {"gauss": "magnetometer_ga"},
    "vehicle_odometry": {
        "m": "position x y z",
        "m/s": "velocity vx vy vz",
        "rad/s": "angular_velocity rollspeed pitchspeed yawspeed",
    },
    "vehicle_optical_flow": {
        "rad": "pixel_flow delta_angle",
        "us": "integration_timespan_us",
        "rad/s": "max_flow_rate",
        "m": "min_ground_distance max_ground_distance",
    },
    "vehicle_rates_setpoint": {"rad/s": "roll pitch yaw"},
    "wind": {"m/s": "windspeed_north windspeed_east tas_innov", "rad": "beta_innov"},
    "yaw_estimator_status": {"rad": "yaw_composite yaw", "m/s": "innov_vn innov_ve"},
}

# topics of another topic's definition
_SAME: Mapping[str, str] = {
    "estimator_attitude": "vehicle_attitude",
    "estimator_global_position": "vehicle_global_position",
    "estimator_gnss_hgt_bias": "estimator_baro_bias",
    "estimator_local_position": "vehicle_local_position",
    "estimator_odometry": "vehicle_odometry",
    "estimator_rng_hgt_bias": "estimator_baro_bias",
    "estimator_wind": "wind",
    "external_ins_global_position": "vehicle_global_position",
    "external_ins_local_position": "vehicle_local_position",
    "fw_virtual_attitude_setpoint": "vehicle_attitude_setpoint",
    "mc_virtual_attitude_setpoint": "vehicle_attitude_setpoint",
    "vehicle_gps_position": "sensor_gps",
    "vehicle_local_position_setpoint": "trajectory_setpoint",
    "vehicle_mocap_odometry": "vehicle_odometry",
    "vehicle_vision_attitude": "vehicle_attitude",
    "vehicle_visual_odometry": "vehicle_odometry",
    "wind_estimate": "wind",
}


@lru_cache(maxsize=1 << 13)
def px4_unit(topic: str, field: str) -> str:
    """The unit of a field of a PX4 topic; "" where none is stated.

    Parameters
    ----------
    topic : e.g. "vehicle_attitude_groundtruth".
    field : dotted name, e.g. "esc[0].esc_rpm".

    Examples
    --------
    >>> px4_unit("sensor_combined", "gyro_rad"), px4_unit("esc_status", "esc[3].esc_rpm"), px4_unit("x", "y")
    ('rad/s', 'rpm', '')
    """
    if field.rpartition(".")[2] in _TIMES:
        return "us"
    name = _INDEX.sub("", field)
    return _fields(topic.removesuffix("_groundtruth")).get(name) or unit_behind(name.rpartition(".")[2])


def px4_topic(message_type: str) -> str:
    """The topic named like a message of PX4's ROS 2 package: px4_msgs/msg/SensorGps -> sensor_gps."""
    return _CAPITAL.sub("_", message_type.rpartition("/")[2]).lower()


@cache
def _fields(topic: str) -> Mapping[str, str]:
    """Field -> unit of a topic."""
    stated = _STATED.get(_SAME.get(topic, topic), {})
    return {field: unit for unit, fields in stated.items() for field in fields.split()}
