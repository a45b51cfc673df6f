"""Distributions in the configuration of a data set."""


def uniform(low, high, **what) -> dict:
    return what | {"distribution": "uniform", "low": low, "high": high}


def choice(*values, **what) -> dict:
    return what | {"distribution": "choice", "values": list(values)}
