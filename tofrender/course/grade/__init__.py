"""Grading of submissions: points, reasons and results files (`tofrender grade`)."""
