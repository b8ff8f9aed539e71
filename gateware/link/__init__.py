"""Packets over a byte stream."""
