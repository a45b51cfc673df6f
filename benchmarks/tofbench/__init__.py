"""Tests of transient renderers with closed forms and reference scenes, see README.md."""
