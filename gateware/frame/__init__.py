"""Rows and headers of two frames, on their way to the link."""
