"""A recording replayed inside SUMO, where its vehicles can be taken over."""
