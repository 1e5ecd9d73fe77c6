"""Settings of scans: route, camera, defects, fusion; presets for known kinds of scanners."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from gibson_sim.errors import ConfigError
from gibson_sim.settings import check_settings, setting

AS_READ, AUTO = "as-read", "auto"
"""Values of the pose convention besides the named ones: that of the layout, and automatic detection."""
CAMERA_CONVENTIONS = {
    "opencv": "camera-to-world, cameras look along z with y down",
    "opengl": "camera-to-world, cameras look along -z with y up",
    "opencv-world-to-camera": "world-to-camera, cameras look along z with y down",
    "opengl-world-to-camera": "world-to-camera, cameras look along -z with y up",
}
"""Pose conventions of files: name -> meaning."""


@dataclass(frozen=True, slots=True)
class TourSettings:
    """Route of the rig and directions of its cameras."""

    coverage: float = setting(
        0.98, "Fraction of the surface visible from free positions that the stations must cover", minimum=0.01, maximum=1.0
    )
    frames: int = setting(
        0, "Largest number of images of all cameras; 0 = as many as the coverage needs", minimum=0, maximum=1_000_000
    )
    seed: int = setting(0, "Random seed of stations, poses and all defects", minimum=0, maximum=2**63 - 1)
    height_min: float = setting(1.2, "Minimum height of the cameras above the floor", unit="m", minimum=0.1, maximum=10.0)
    height_max: float = setting(1.6, "Maximum height of the cameras above the floor", unit="m", minimum=0.1, maximum=10.0)
    clearance: float = setting(0.3, "Clearance between the rig and obstacles on the floor", unit="m", minimum=0.05, maximum=2.0)
    turn_deg: float = setting(30.0, "Yaw step between views at a station", unit="deg", minimum=1.0, maximum=120.0)
    path_spacing: float = setting(
        0.5, "Distance between views on the path between stations; 0 = no views there", unit="m", minimum=0.0, maximum=10.0
    )
    pitches_deg: str = setting(
        "-35,0,35", "Pitch of each camera of the rig, up is positive, as in --pitches-deg=-35,0,35", unit="deg"
    )
    speed: float = setting(
        0.4, "Speed along the path; motion blur and drift depend on it", unit="m/s", minimum=0.01, maximum=10.0
    )
    turn_speed_deg: float = setting(30.0, "Yaw rate of turns", unit="deg/s", minimum=1.0, maximum=360.0)
    wobble_deg: float = setting(
        0.0, "Standard deviation of the rig's tilt, as of a hand-held scanner", unit="deg", minimum=0.0, maximum=20.0
    )

    def __post_init__(self) -> None:
        check_settings(self)
        if self.height_max < self.height_min:
            raise ConfigError(
                f"setting 'height_max' is {self.height_max:g} m, must not be below height_min, {self.height_min:g} m"
            )
        _ = self.pitches

    @property
    def pitches(self) -> tuple[float, ...]:
        """Pitch of each camera, degrees, positive upwards.

        Raises:
            ConfigError: the setting is no list of angles.
        """
        try:
            angles = tuple(float(word) for word in self.pitches_deg.split(","))
        except ValueError:
            angles = ()
        if not angles or len(angles) > 16 or not all(-90.0 <= angle <= 90.0 for angle in angles):
            raise ConfigError(
                f"setting 'pitches_deg' is {self.pitches_deg!r}, must be 1 to 16 angles from -90 to 90 as in -35,0,35"
            )
        return angles


@dataclass(frozen=True, slots=True)
class ScanCamera:
    """Camera of the rig; all cameras of a rig have the same settings."""

    width: int = setting(640, "Image width", unit="px", minimum=16, maximum=8192)
    height: int = setting(480, "Image height", unit="px", minimum=16, maximum=8192)
    fov_y_deg: float = setting(46.0, "Vertical field of view", unit="deg", minimum=5.0, maximum=150.0)
    samples: int = setting(4, "Colour samples per pixel: 1 or 4", minimum=1, maximum=4)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, slots=True)
class Defects:
    """Error model of a scanner: depths, poses, colours. The defaults only limit the range."""

    depth_constant: float = setting(0.0, "Depth noise: constant term", unit="m", minimum=0.0, maximum=1.0)
    depth_linear: float = setting(0.0, "Depth noise: coefficient of the depth z", minimum=0.0, maximum=1.0)
    depth_quadratic: float = setting(0.0, "Depth noise: coefficient of z^2", unit="1/m", minimum=0.0, maximum=1.0)
    disparity_step_px: float = setting(
        0.0, "Quantisation step of the disparity; 0 = no quantisation", unit="px", minimum=0.0, maximum=8.0
    )
    baseline: float = setting(
        0.075, "Baseline between camera and projector: disparity = fx baseline / z", unit="m", minimum=1e-3, maximum=2.0
    )
    range_min: float = setting(0.1, "Minimum range; nearer surfaces have no depth", unit="m", minimum=0.0, maximum=10.0)
    range_max: float = setting(10.0, "Maximum range; farther surfaces have no depth", unit="m", minimum=0.1, maximum=1000.0)
    hole_angle_deg: float = setting(
        90.0,
        "Largest angle of incidence, from the surface normal, with depth; 90 = no limit",
        unit="deg",
        minimum=1.0,
        maximum=90.0,
    )
    hole_fraction: float = setting(0.0, "Fraction of pixels without depth, at random", minimum=0.0, maximum=1.0)
    edge_px: int = setting(
        0, "Distance from depth edges within which depth is lost, in patches; 0 = no loss", unit="px", minimum=0, maximum=50
    )
    flying_fraction: float = setting(
        0.0, "Fraction of edge pixels that are flying pixels: their depth is between the two surfaces", minimum=0.0, maximum=1.0
    )
    dark_fraction: float = setting(
        0.0, "Fraction of depth lost on black surfaces; none is lost on grey ones", minimum=0.0, maximum=1.0
    )
    shiny_fraction: float = setting(0.0, "Fraction of depth lost on surfaces of shiny_classes", minimum=0.0, maximum=1.0)
    shiny_classes: str = setting(
        "mirror,window,glass,tv,screen", "Semantic classes whose name contains one of these words are shiny"
    )
    pose_noise_m: float = setting(0.0, "Standard deviation of the position error, per axis", unit="m", minimum=0.0, maximum=1.0)
    pose_noise_deg: float = setting(
        0.0, "Standard deviation of the orientation error, per axis", unit="deg", minimum=0.0, maximum=30.0
    )
    drift_m: float = setting(
        0.0,
        "Position drift after 1 m; a random walk, which grows with the square root of the distance",
        unit="m",
        minimum=0.0,
        maximum=1.0,
    )
    drift_deg: float = setting(0.0, "Heading drift after 1 m; a random walk", unit="deg", minimum=0.0, maximum=30.0)
    exposure_jitter_ev: float = setting(
        0.0, "Standard deviation of the exposure from view to view", unit="EV", minimum=0.0, maximum=4.0
    )
    white_balance_jitter: float = setting(
        0.0, "Standard deviation of the white balance, as a fraction of 6500 K", minimum=0.0, maximum=0.3
    )
    vignette: float = setting(0.0, "Vignetting: fraction of light lost in the corners", minimum=0.0, maximum=1.0)
    shutter_s: float = setting(0.0, "Exposure time, which causes motion blur", unit="s", minimum=0.0, maximum=1.0)
    shot_noise: float = setting(
        0.0, "Shot noise at full white; it grows with the square root of the light", minimum=0.0, maximum=1.0
    )
    read_noise: float = setting(0.0, "Read noise, independent of the light", minimum=0.0, maximum=1.0)
    jpeg_quality: int = setting(95, "JPEG quality of the colour images", minimum=10, maximum=100)

    def __post_init__(self) -> None:
        check_settings(self)
        if self.range_max <= self.range_min:
            raise ConfigError(f"setting 'range_max' is {self.range_max:g} m, must be above range_min, {self.range_min:g} m")


_FINEST_VOXEL = 0.001
"""Smallest voxel, metres."""


@dataclass(frozen=True, slots=True)
class FuseSettings:
    """Settings of the fusion of posed RGB-D into a mesh."""

    voxel: float = setting(
        0.0,
        "Voxel size, and size of the smallest triangles; 0 = as fine as the cameras resolve and memory allows, at least 0.01",
        unit="m",
        minimum=0.0,
        maximum=0.5,
    )
    memory: float = setting(
        4.0, "Memory limit of the voxels, which bounds an automatic voxel size", unit="GB", minimum=0.1, maximum=1000.0
    )
    truncation: float = setting(4.0, "Truncation distance of the TSDF, in voxels", minimum=1.0, maximum=32.0)
    depth_max: float = setting(4.0, "Largest depth that is fused; far depths are noisy", unit="m", minimum=0.1, maximum=1000.0)
    stride: int = setting(1, "Use every N-th frame", minimum=1, maximum=10_000)
    min_weight: float = setting(
        2.0, "Smallest weight (number of images) of a voxel; voxels below it become holes", minimum=0.0, maximum=100.0
    )
    min_part: float = setting(
        0.02,
        "Smallest area of a connected component; smaller ones are removed; 0 = keep all",
        unit="m^2",
        minimum=0.0,
        maximum=1000.0,
    )
    triangles: int = setting(0, "Simplify the mesh to this many triangles; 0 = keep all", minimum=0, maximum=100_000_000)
    snap: float = setting(
        0.02,
        "Largest displacement of vertices snapped to the planes of walls, floors and ceilings; 0 = no snapping",
        unit="m",
        minimum=0.0,
        maximum=0.1,
    )
    level: bool = setting(False, "Turn the mesh so that z is up and the floor is at z = 0, for scans in the frame of a camera")

    def __post_init__(self) -> None:
        check_settings(self)
        if 0.0 < self.voxel < _FINEST_VOXEL:
            raise ConfigError(f"setting 'voxel' is {self.voxel:g} m, must be 0 (automatic) or at least {_FINEST_VOXEL:g} m")


PRESETS: dict[str, dict[str, Any]] = {
    "clean": {},
    "kinect": {
        "depth_quadratic": 0.0019, "depth_constant": 0.0008, "disparity_step_px": 0.125, "range_min": 0.5, "range_max": 4.5,
        "hole_angle_deg": 78.0, "hole_fraction": 0.002, "edge_px": 4, "flying_fraction": 0.15, "dark_fraction": 0.6,
        "shiny_fraction": 0.9, "pose_noise_m": 0.002, "pose_noise_deg": 0.15, "drift_m": 0.002, "drift_deg": 0.05,
        "exposure_jitter_ev": 0.12, "white_balance_jitter": 0.04, "vignette": 0.25, "shutter_s": 1.0 / 120.0,
        "shot_noise": 0.02, "read_noise": 0.006, "jpeg_quality": 90,
        "pitches_deg": "-30,10", "wobble_deg": 1.5, "samples": 1,
    },
    "phone": {
        "depth_linear": 0.004, "depth_quadratic": 0.001, "range_min": 0.25, "range_max": 5.0, "hole_angle_deg": 82.0, "edge_px": 2,
        "flying_fraction": 0.5, "dark_fraction": 0.3, "shiny_fraction": 0.7, "pose_noise_m": 0.003, "pose_noise_deg": 0.25,
        "drift_m": 0.006, "drift_deg": 0.12, "exposure_jitter_ev": 0.3, "white_balance_jitter": 0.08, "vignette": 0.15,
        "shutter_s": 1.0 / 50.0, "shot_noise": 0.03, "read_noise": 0.008, "jpeg_quality": 88,
        "pitches_deg": "-28,12", "wobble_deg": 3.0, "fov_y_deg": 55.0, "turn_deg": 24.0, "samples": 1,
    },
}  # fmt: skip
"""Name -> settings that differ from the defaults. ``clean``: three cameras on a tripod without errors, range 10 m."""
