"""Grading what students hand in: points, reasons and results files (`tofrender grade`)."""
