"""Files of measured captures, a module for each family, and those of synthetic data sets."""
