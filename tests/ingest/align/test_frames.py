import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from flysid.ingest.align import frames

angle = st.floats(-3.1, 3.1)
steep = st.floats(-1.5, 1.5)


@settings(max_examples=100, deadline=None)
@given(angle, steep, angle, st.sampled_from([1.0, -3.0]))
def test_euler_angles_are_those_of_the_rotation(roll: float, pitch: float, yaw: float, length: float) -> None:
    x, y, z, w = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat()
    q = length * np.array([w, x, y, z])
    found = [frames.roll_of(q)[0], frames.pitch_of(q)[0], frames.yaw_of(q)[0]]
    np.testing.assert_allclose(found, [roll, pitch, yaw], atol=1e-6)


def test_heading_frame_flying_east_with_the_nose_east_is_forward() -> None:
    east = np.array([2.0])
    np.testing.assert_allclose(frames.forward_of(0.0 * east, east, np.pi / 2), [2.0])
    np.testing.assert_allclose(frames.right_of(0.0 * east, east, 0.0), [2.0])


def test_a_quaternion_of_length_zero_is_nan() -> None:
    assert np.isnan(frames.roll_of([[0.0, 0.0, 0.0, 0.0]])).all()
