"""Bugs planted in the package, each with tests that must fail: `make mutants`."""
