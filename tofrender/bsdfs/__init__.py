"""Materials; their plugin is registered by `tofrender.backend`."""
