"""What one looks at and touches: applications in a browser, and in notebooks."""
