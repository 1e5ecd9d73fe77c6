"""Angular velocities and specific forces of an IMU, and their errors."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import quat_from_rpy
from gibson_sim.robots.sensor_specs import ImuSpec
from gibson_sim.sensors.imu import LEAST_VARIANCE, Imu, ImuReading
from gibson_sim.types import NS_PER_S, SceneState

GRAVITY = (0.0, 0.0, -9.81)
Numbers = tuple[float, float, float]
ZERO = (0.0, 0.0, 0.0)


def state(
    time: float = 0.0, rpy: Numbers = ZERO, linear: Numbers = ZERO, angular: Numbers = ZERO, links: tuple[str, ...] = ("r/imu",)
) -> SceneState:
    twist = np.array([[*linear, *angular]])
    return SceneState(round(time * NS_PER_S), 1, 1, links, np.zeros((1, 3)), np.array([quat_from_rpy(*rpy)]), twist)


def samples(spec: ImuSpec, count: int, seed: int = 0) -> np.ndarray:
    """Returns (count, 6) measurements at rest, without gravity."""
    imu = Imu(spec, ZERO, seed)
    readings = [imu.measure(state((i + 1) / spec.rate_hz)) for i in range(count)]
    return np.array([[*r.angular_velocity, *r.linear_acceleration] for r in readings])


def test_at_rest_it_feels_gravity_upwards() -> None:
    imu = Imu(ImuSpec("r/imu"), GRAVITY)
    for time in (0.01, 0.02):
        reading = imu.measure(state(time))
        assert reading.linear_acceleration.tolist() == [0.0, 0.0, 9.81]
        assert reading.angular_velocity.tolist() == [0.0, 0.0, 0.0]


def test_nose_up_it_feels_gravity_forward() -> None:
    # A negative pitch lifts the nose: at 30 degrees half of g pushes from behind.
    reading = Imu(ImuSpec("r/imu"), GRAVITY).measure(state(rpy=(0.0, math.radians(-30), 0.0)))
    assert reading.linear_acceleration.tolist() == pytest.approx([9.81 / 2, 0.0, 9.81 * math.sqrt(0.75)])


def test_rolled_to_the_right_it_feels_gravity_to_the_left() -> None:
    reading = Imu(ImuSpec("r/imu"), GRAVITY).measure(state(rpy=(math.radians(90), 0.0, 0.0)))
    assert reading.linear_acceleration.tolist() == pytest.approx([0.0, 9.81, 0.0])


def test_free_fall_feels_nothing() -> None:
    imu = Imu(ImuSpec("r/imu"), GRAVITY)
    imu.measure(state(0.0))
    reading = imu.measure(state(0.5, linear=(0.0, 0.0, -9.81 * 0.5)))
    assert reading.linear_acceleration.tolist() == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


def test_acceleration_is_in_the_frame_of_the_link() -> None:
    # It faces left (y of the world) and gains 0.2 m/s along y in 0.1 s: 2 m/s^2 forward.
    imu = Imu(ImuSpec("r/imu"), GRAVITY)
    left = (0.0, 0.0, math.pi / 2)
    imu.measure(state(1.0, left))
    assert imu.measure(state(1.1, left, (0.0, 0.2, 0.0))).linear_acceleration.tolist() == pytest.approx([2.0, 0.0, 9.81])


def test_angular_velocity_is_in_the_frame_of_the_link() -> None:
    # On its right side, its y axis is the world's z.
    reading = Imu(ImuSpec("r/imu"), GRAVITY).measure(state(rpy=(math.pi / 2, 0.0, 0.0), angular=(0.0, 0.0, 0.7)))
    assert reading.angular_velocity.tolist() == pytest.approx([0.0, 0.7, 0.0])


def test_circle_gives_the_centripetal_acceleration_to_the_left() -> None:
    # 0.5 m/s on a circle of 0.25 m, counter-clockwise: 2 rad/s, v^2 / r = 1 m/s^2 towards the centre.
    imu, readings = Imu(ImuSpec("r/imu"), GRAVITY), []
    for i in range(3):
        yaw = 0.3 + 2.0 * 0.01 * i
        velocity = (0.5 * math.cos(yaw), 0.5 * math.sin(yaw), 0.0)
        readings.append(imu.measure(state(0.01 * i, (0.0, 0.0, yaw), velocity, (0.0, 0.0, 2.0))))
    for reading in readings[1:]:
        assert reading.linear_acceleration.tolist() == pytest.approx([0.0, 1.0, 9.81], abs=1e-4)


def test_quaternion_that_changed_its_sign_is_the_same_orientation() -> None:
    imu = Imu(ImuSpec("r/imu"), GRAVITY)
    first = state(0.0)
    imu.measure(first)
    second = SceneState(10_000_000, 1, 1, first.links, first.positions, -first.quats_xyzw, np.array([[0.02, 0, 0, 0, 0, 0]]))
    assert imu.measure(second).linear_acceleration.tolist() == pytest.approx([2.0, 0.0, 9.81])


def test_after_a_reset_the_jump_of_velocity_is_not_felt() -> None:
    imu = Imu(ImuSpec("r/imu"), GRAVITY)
    imu.measure(state(5.0, linear=(0.5, 0.0, 0.0)))
    imu.reset()
    assert imu.measure(state(0.01)).linear_acceleration.tolist() == [0.0, 0.0, 9.81]


def test_going_back_in_time_without_a_reset_is_refused() -> None:
    imu = Imu(ImuSpec("r/imu"), GRAVITY)
    imu.measure(state(5.0))
    with pytest.raises(ConfigError, match="reset it first"):
        imu.measure(state(0.01))


def test_unknown_link_is_refused() -> None:
    with pytest.raises(ConfigError, match="'r/gone'"):
        Imu(ImuSpec("r/gone"), GRAVITY).measure(state())


def test_orientation_is_that_of_the_link_or_not_reported() -> None:
    def reading(*, orientation: bool) -> ImuReading:
        return Imu(ImuSpec("r/imu", orientation=orientation), GRAVITY).measure(state(rpy=(0.0, 0.0, math.pi / 2)))

    assert reading(orientation=True).orientation_xyzw == pytest.approx((0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))
    assert reading(orientation=False).orientation_xyzw is None


@pytest.mark.parametrize("rate_hz", [25.0, 400.0])
def test_white_noise_grows_with_the_root_of_the_rate(rate_hz: float) -> None:
    # The standard deviation of a sample is density * sqrt(rate); 18000 values estimate it to 0.5 %.
    got = samples(ImuSpec("r/imu", rate_hz=rate_hz, gyro_noise=0.01, accel_noise=0.2), 6000)
    assert got[:, :3].std() == pytest.approx(0.01 * math.sqrt(rate_hz), rel=0.02)
    assert got[:, 3:].std() == pytest.approx(0.2 * math.sqrt(rate_hz), rel=0.02)
    assert abs(got.mean(axis=0) / got.std(axis=0)).max() < 4 / math.sqrt(6000)


def test_axes_have_noise_of_their_own() -> None:
    correlation = np.corrcoef(samples(ImuSpec("r/imu", gyro_noise=0.01, accel_noise=0.2), 6000).T)
    assert abs(correlation - np.eye(6)).max() < 5 / math.sqrt(6000)


def test_white_noise_averages_out_as_the_root_of_the_time() -> None:
    # Allan deviation of white noise: density / sqrt(tau). Means of 100 samples at 100 Hz have the density as their deviation.
    got = samples(ImuSpec("r/imu", gyro_noise=0.01), 20_000)[:, :3]
    assert got.reshape(200, 100, 3).mean(axis=1).std() == pytest.approx(0.01, rel=0.1)


def test_reported_variance_is_that_of_the_samples() -> None:
    reading = Imu(ImuSpec("r/imu", rate_hz=100.0, gyro_noise=0.01, accel_noise=0.2), GRAVITY).measure(state())
    assert (reading.angular_variance, reading.linear_variance) == pytest.approx((0.01, 4.0))


def test_reported_variance_holds_the_bias_and_how_far_it_walked() -> None:
    # 100 devices after 4 s: white 0.01^2 * 25, bias 0.03^2, walk 0.02^2 * 4 and the same of the accelerometers, times 100.
    spec = ImuSpec(
        "r/imu", rate_hz=25.0, gyro_noise=0.01, accel_noise=0.1, gyro_bias=0.03, accel_bias=0.3, gyro_bias_walk=0.02,
        accel_bias_walk=0.2,
    )  # fmt: skip
    errors, variances = [], set()
    for seed in range(100):
        imu = Imu(spec, GRAVITY, seed)
        for i in range(1, 101):
            reading = imu.measure(state(0.04 * i))
        errors.append([*reading.angular_velocity, *(reading.linear_acceleration - [0.0, 0.0, 9.81])])
        variances.add((reading.angular_variance, reading.linear_variance))
    ((angular, linear),) = variances
    assert (angular, linear) == pytest.approx((0.005, 0.5))
    nees = np.array(errors) ** 2 / np.repeat([angular, linear], 3)
    assert nees.sum(axis=1).mean() == pytest.approx(6.0, abs=4 * math.sqrt(12.0 / 100))


def test_variance_is_that_of_the_samples_that_are_really_taken() -> None:
    # 1000 Hz requested, at 240 steps a second.
    imu = Imu(ImuSpec("r/imu", rate_hz=1000.0, gyro_noise=0.01), GRAVITY)
    imu.measure(state(1.0))
    assert imu.measure(state(1.0 + 1.0 / 240)).angular_variance == pytest.approx(0.01**2 * 240, rel=1e-3)


def test_variance_without_noise_is_small_but_not_unknown() -> None:
    reading = Imu(ImuSpec("r/imu"), GRAVITY).measure(state())
    assert reading.angular_variance == reading.linear_variance == LEAST_VARIANCE > 0.0


def test_bias_walks_as_the_root_of_the_time() -> None:
    # 100 sensors, 4 s each: walk * sqrt(4 s) = 2 walk, known to 1 / sqrt(2 * 300) = 4 %.
    spec = ImuSpec("r/imu", rate_hz=50.0, gyro_bias_walk=0.001, accel_bias_walk=0.03)
    ends = np.array([samples(spec, 201, seed)[[0, -1]] for seed in range(100)])
    walked = ends[:, 1] - ends[:, 0]
    assert walked[:, :3].std() == pytest.approx(0.002, rel=0.12)
    assert walked[:, 3:].std() == pytest.approx(0.06, rel=0.12)


def test_steps_of_the_bias_are_independent_of_the_noise_of_their_sample() -> None:
    # At 1 Hz a step of the bias and the noise are equally large: the variance of a difference is that of two noises and one step.
    got = np.diff(samples(ImuSpec("r/imu", rate_hz=1.0, accel_noise=1.0, accel_bias_walk=1.0), 6000)[:, 3:], axis=0)
    assert got.var() == pytest.approx(3.0, rel=0.05)


def test_initial_biases_differ_between_seeds_as_told_and_stay() -> None:
    spec = ImuSpec("r/imu", gyro_bias=0.01, accel_bias=0.3)
    got = np.array([samples(spec, 2, seed) for seed in range(300)])
    assert np.array_equal(got[:, 0], got[:, 1])
    assert got[:, 0, :3].std() == pytest.approx(0.01, rel=0.1)
    assert got[:, 0, 3:].std() == pytest.approx(0.3, rel=0.1)


NOISY = ImuSpec("r/imu", gyro_noise=0.01, accel_noise=0.1, gyro_bias=0.1, accel_bias=1.0, gyro_bias_walk=0.1, accel_bias_walk=0.1)


def test_same_seed_gives_the_same_bits_and_another_one_does_not() -> None:
    assert np.array_equal(samples(NOISY, 20, 3), samples(NOISY, 20, 3))
    assert not np.isclose(samples(NOISY, 20, 3), samples(NOISY, 20, 4)).any()


def test_after_a_reset_the_same_errors_come_again() -> None:
    imu = Imu(NOISY, GRAVITY)
    first = [imu.measure(state(0.01 * i)).linear_acceleration.tolist() for i in range(1, 5)]
    imu.reset()
    assert [imu.measure(state(0.01 * i)).linear_acceleration.tolist() for i in range(1, 5)] == first


def test_imus_of_two_robots_err_differently() -> None:
    other = ImuSpec("s/imu", accel_noise=0.1)
    a = Imu(ImuSpec("r/imu", accel_noise=0.1), GRAVITY).measure(state()).linear_acceleration
    b = Imu(other, GRAVITY).measure(state(links=("s/imu",))).linear_acceleration
    assert not np.isclose(a, b).any()
