"""Tests of transient renderers against closed forms and reference scenes; see README.md."""
