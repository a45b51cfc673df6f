"""The space of scenes with participating media, see `media.transport` for its algorithms."""

from __future__ import annotations

from .attached import AttachedMedia
from .transport import MediaTransport


class Media(MediaTransport):
    """Straight rays through homogeneous media and grids, see `MediaTransport`."""

    def attached(self) -> AttachedMedia:
        """Return these media with derivatives."""
        return AttachedMedia(self)
