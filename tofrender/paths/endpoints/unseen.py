"""What endpoints have in common that paths cannot run into."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi

from ...runtime import checks
from ..camera import behind_emitters
from ..records import Bounce, Connection, Hit, Path, Turn, Vertex


class Unseen:
    """A light that no ray runs into; the emitters of the scene are dark.

    Args:
        scene: The scene.
        hide_emitters: Whether the sensor looks through the scene's area lights.
    """

    connects = True
    finds_all = True
    importance = False
    looks_ahead = False

    def __init__(self, scene: mi.Scene, hide_emitters: bool = False) -> None:
        if not hasattr(scene, "sample_emitter_direction"):
            raise ValueError(f"scene = {checks.quote(scene)}: must be a loaded scene")
        self.scene = scene
        self.hide_emitters = checks.boolean("hide_emitters", hide_emitters)

    def resolving(self, width_opl: float) -> Any:
        """The same: how finely lengths are told apart makes no difference."""
        return self

    def attached(self) -> Any:
        """The same."""
        return self

    def begin(self, ray: mi.Ray3f) -> mi.Ray3f:
        """The sensor's ray, behind the area lights that are hidden."""
        return behind_emitters(self.scene, ray) if self.hide_emitters else ray

    def in_view(self) -> Sequence[mi.Emitter]:
        """None."""
        return ()

    def memory(self) -> Any:
        """Nothing."""
        return None

    def remember(self, path: Path, vertex: Vertex, active: mi.Bool) -> Any:
        """Nothing: connections do not depend on earlier vertices."""
        return path.memory

    def leave(self, path: Path, vertex: Vertex, bounce: Bounce) -> Any:
        """Nothing."""
        return path.memory

    def more_links(self, path: Path, first: Connection) -> Any:
        """None: one connection for a vertex."""
        return None

    def share_of_hit(self, path: Path, vertex: Vertex, hit: Hit) -> mi.Float:
        """All after a mirror, which no connection serves; else nothing."""
        return dr.select(path.specular, mi.Float(1), 0)

    def share_of_link(self, path: Path, vertex: Vertex, link: Connection, turn: Turn) -> mi.Float:
        """All."""
        return mi.Float(1)

    def hit(self, vertex: Vertex, path: Path) -> Hit:
        """No light."""
        return Hit(mi.UnpolarizedSpectrum(0), mi.Float(0), vertex.length, mi.Bool(False))

    def nearest(self, p: mi.Point3f) -> mi.Float:
        """No bound."""
        return mi.Float(0)
