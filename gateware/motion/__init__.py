"""Encoder, index barrier, motor and laser."""
