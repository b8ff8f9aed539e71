"""Clouds of points: files and pictures."""
