"""Segments in, velocities out."""
