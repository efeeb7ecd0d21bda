"""Lanelet2 maps: read into lanes, and written."""
