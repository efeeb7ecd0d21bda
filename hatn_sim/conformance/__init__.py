"""Whether somebody's own predictor or agent keeps what the protocols ask of it."""
