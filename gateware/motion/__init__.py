"""Encoder, index barrier, motor and laser."""

from .angle import AngleStamp
from .interlock import LaserState
from .motion import Motion

__all__ = ["AngleStamp", "LaserState", "Motion"]
