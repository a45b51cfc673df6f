"""What endpoints have in common that paths cannot run into."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from ..camera import behind_emitters
from ..records import Hit, Path, Vertex


class Unseen:
    """A light that no ray runs into; the emitters of the scene are dark.

    Args:
        scene: The scene.
        hide_emitters: Whether the sensor looks through the scene's area lights.
    """

    connects = True
    finds_all = True

    def __init__(self, scene: mi.Scene, hide_emitters: bool = False) -> None:
        self.scene, self.hide_emitters = scene, hide_emitters

    def begin(self, ray: mi.Ray3f) -> mi.Ray3f:
        """The sensor's ray, behind the area lights that are hidden."""
        return behind_emitters(self.scene, ray) if self.hide_emitters else ray

    def memory(self) -> Any:
        """Nothing."""
        return None

    def remember(self, memory: Any, vertex: Vertex, active: mi.Bool) -> Any:
        """Nothing: connections do not depend on earlier vertices."""
        return memory

    def hit(self, vertex: Vertex, path: Path) -> Hit:
        """No light."""
        return Hit(mi.UnpolarizedSpectrum(0), mi.Float(0), vertex.length, mi.Bool(False))

    def nearest(self, p: mi.Point3f) -> mi.Float:
        """No bound."""
        return mi.Float(0)
