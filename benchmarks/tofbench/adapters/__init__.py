"""One module for each renderer. No other module imports renderers."""
