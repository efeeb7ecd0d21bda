"""Tracks in INTERACTION format: CSV files, read in bounded memory, and written."""
