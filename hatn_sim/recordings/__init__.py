"""Recorded traffic, whatever its format: each a `datatypes.Recording`, found by `find.py`."""
