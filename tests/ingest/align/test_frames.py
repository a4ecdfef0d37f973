import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.ingest.align import frames

angle = st.floats(-3.1, 3.1)
steep = st.floats(-1.5, 1.5)


@settings(max_examples=100, deadline=None)
@given(angle, steep, angle)
def test_euler_angles_survive_the_way_through_a_quaternion(roll: float, pitch: float, yaw: float) -> None:
    q = frames.quaternion_of(roll, pitch, yaw)
    assert np.linalg.norm(q) == pytest.approx(1.0)
    back = [frames.roll_of(q)[0], frames.pitch_of(q)[0], frames.yaw_of(q)[0]]
    np.testing.assert_allclose(back, [roll, pitch, yaw], atol=1e-6)
    np.testing.assert_allclose(
        [f(-3.0 * q)[0] for f in (frames.roll_of, frames.pitch_of)], [roll, pitch], atol=1e-6
    )


@settings(max_examples=50, deadline=None)
@given(angle, steep, angle)
def test_rotation_agrees_with_the_rotation_matrix(roll: float, pitch: float, yaw: float) -> None:
    from scipy.spatial.transform import Rotation

    v = np.array([[1.0, -2.0, 0.5]])
    q = frames.quaternion_of(roll, pitch, yaw)
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll]).apply(v)
    np.testing.assert_allclose(frames.earth_from_body(q, v), expected, atol=1e-12)
    np.testing.assert_allclose(frames.body_from_earth(q, expected), v, atol=1e-12)


def test_nose_up_is_positive_pitch_and_lifts_the_forward_axis_in_frd() -> None:
    nose = frames.earth_from_body(frames.quaternion_of(0.0, 0.2, 0.0), [[1.0, 0.0, 0.0]])
    assert nose[0, 2] < 0  # down is positive


@pytest.mark.parametrize("frame", [frames.flu_from_frd, frames.enu_from_ned])
def test_frame_changes_are_their_own_inverse(frame: object) -> None:
    v = np.array([[1.0, 2.0, 3.0], [-4.0, 5.0, -6.0]])
    assert callable(frame)
    np.testing.assert_array_equal(frame(frame(v)), v)


def test_heading_frame_flying_east_with_the_nose_east_is_forward() -> None:
    east = np.array([2.0])
    np.testing.assert_allclose(frames.forward_of(0.0 * east, east, np.pi / 2), [2.0])
    np.testing.assert_allclose(frames.right_of(0.0 * east, east, 0.0), [2.0])


def test_a_quaternion_of_length_zero_is_nan() -> None:
    assert np.isnan(frames.roll_of([[0.0, 0.0, 0.0, 0.0]])).all()
