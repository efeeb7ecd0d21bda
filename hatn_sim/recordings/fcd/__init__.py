"""SUMO's floating car data: read as it comes, and written."""
