"""Drivers of stages: what they move is at the end of a serial line, and neither is to be trusted."""

from hardware.stages.bistep import BiStep2A04
from hardware.stages.grbl import Grbl
from hardware.stages.kinds import STAGE_KINDS, register_stage
from hardware.stages.line import Line
from hardware.stages.marlin import Marlin
from hardware.stages.travel_settings import Travel

__all__ = ["STAGE_KINDS", "BiStep2A04", "Grbl", "Line", "Marlin", "Travel", "register_stage"]
