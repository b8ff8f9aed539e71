"""Tests, benchmarks and what they need."""
