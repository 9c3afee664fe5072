"""Photographs of a known world through a known rig, by ray casting."""

from jaxscan.simulation.distance import distance
from jaxscan.simulation.light import Lighting, Sensor
from jaxscan.simulation.profile import Profile, true_profile
from jaxscan.simulation.render import render
from jaxscan.simulation.scene import Body, Scene

__all__ = ["Body", "Lighting", "Profile", "Scene", "Sensor", "distance", "render", "true_profile"]
