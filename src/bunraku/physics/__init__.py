"""Physics of apparel: the rigid bodies and springs of MMD and VRM characters, simulated."""

from __future__ import annotations

from bunraku.physics.apparel_rig import ApparelRig
from bunraku.physics.from_file import apparel_rig
from bunraku.physics.settings import PhysicsSettings
from bunraku.physics.simulate import Recovery, Simulation, SimulationReport, simulate

__all__ = ["ApparelRig", "PhysicsSettings", "Recovery", "Simulation", "SimulationReport", "apparel_rig", "simulate"]
