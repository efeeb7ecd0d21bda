"""A SUMO net from any list of lanes."""
