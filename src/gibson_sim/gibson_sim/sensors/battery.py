"""A battery discharged by the power that its robot draws. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gibson_sim.robots.sensor_specs import BatterySpec
from gibson_sim.types import JointStates

_S_PER_H = 3600.0


@dataclass(frozen=True, slots=True)
class BatteryReading:
    """The state of a battery at one tick."""

    name: str
    """Name of the sensor."""
    stamp_ns: int
    percentage: float
    """State of charge, 0 to 1."""
    voltage: float
    """Voltage, V."""
    current: float
    """Current, A; negative while discharging, 0 when empty."""
    charge_ah: float
    """Remaining charge, A h."""
    capacity_ah: float
    """Charge when full, A h."""
    low: bool
    """Whether the charge is below ``BatterySpec.warn_below``."""

    @property
    def empty(self) -> bool:
        """Whether the charge is 0."""
        return self.percentage == 0.0


class Battery:
    """A battery. It integrates energy, so that the result does not depend on the step size."""

    def __init__(self, spec: BatterySpec) -> None:
        """Starts with the initial charge of the spec."""
        self.spec = spec
        self._slope = (spec.voltage_full - spec.voltage_empty) / 2
        self.reset()

    def reset(self) -> None:
        """Restores the initial charge."""
        self._energy = self._energy_at(self.spec.start)

    def power(self, joints: JointStates) -> float:
        """Returns the power that the robot draws at the given joint efforts and velocities, W."""
        spec = self.spec
        mechanical_w = np.maximum(joints.efforts * joints.velocities, 0.0).sum() / spec.efficiency
        return spec.idle_w + float(mechanical_w + spec.torque_w * np.abs(joints.efforts).sum())

    def drain(self, power_w: float, dt: float, stamp_ns: int) -> BatteryReading:
        """Discharges with ``power_w`` for ``dt`` seconds and returns the state at ``stamp_ns``, the end of this time."""
        spec = self.spec
        self._energy = max(0.0, self._energy - power_w * dt)
        charge = self._charge()
        voltage = spec.voltage_empty + 2 * self._slope * charge
        return BatteryReading(
            name=spec.name,
            stamp_ns=stamp_ns,
            percentage=charge,
            voltage=voltage,
            current=-power_w / voltage if charge > 0.0 else 0.0,
            charge_ah=charge * spec.capacity_ah,
            capacity_ah=spec.capacity_ah,
            low=charge < spec.warn_below,
        )

    def _energy_at(self, charge: float) -> float:
        """Returns the energy at a state of charge, J: the integral of the voltage over the charge."""
        spec = self.spec
        return spec.capacity_ah * _S_PER_H * (spec.voltage_empty * charge + self._slope * charge**2)

    def _charge(self) -> float:
        """Returns the state of charge, 0 to 1, for the remaining energy."""
        spec = self.spec
        mean_voltage = self._energy / (spec.capacity_ah * _S_PER_H)
        # The solution of slope q^2 + empty q = mean_voltage in a form that is stable for slope = 0.
        return min(
            1.0, 2 * mean_voltage / (spec.voltage_empty + math.sqrt(spec.voltage_empty**2 + 4 * self._slope * mean_voltage))
        )
