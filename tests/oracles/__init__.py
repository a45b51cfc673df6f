"""Closed forms and independent estimators that tests compare renders with; NumPy alone."""
