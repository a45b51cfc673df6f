"""From a scene to a labelled Dataset."""
