"""Participating media: free flights, transmittance, phase functions and gated connections."""
