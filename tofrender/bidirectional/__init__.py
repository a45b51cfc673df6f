"""Light paths and bidirectional paths: emission, the lens, stored vertices and MIS weights."""
