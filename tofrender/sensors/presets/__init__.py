"""Descriptions of sensors to start from, TOML files for `sense`."""

PRESETS = ("flash_dtof", "scanning_dtof", "itof", "iccd_gate", "streak")
