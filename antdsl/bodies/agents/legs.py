"""The legs of an agent definition and its gaits: in which order and how long feet stand, by speed."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Leg:
    """A leg that is bent at the knee so that its foot stands on the ground. `upper`, `lower` and `foot` are joints: at the hip
    where the thigh (femur) begins, at the knee where the shank (tibia) begins, and at what touches the ground. Each of them lies
    below the one before in the rig, with any joints between."""

    name: str
    upper: str
    lower: str
    foot: str


@dataclass(frozen=True, slots=True)
class Gait:
    """How feet follow each other at one speed. `speed`: units of length of the definition a second; `stride`: how far the body
    goes in one cycle; `duty`: the share of the cycle that each foot stands; `lift`: how high a foot swings, in units of length;
    `phases`: for each leg, in their order, the share of the cycle by which it is ahead.

    Between two gaits of a definition stride, duty and lift are linear in the speed and phases are those of the slower one; below
    the slowest and above the fastest the nearest holds, but for the stride, which grows above the fastest as the speed does, so
    that there are no more cycles a second."""

    name: str
    speed: float
    stride: float
    duty: float
    lift: float
    phases: tuple[float, ...]
