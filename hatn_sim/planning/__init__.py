"""What agents are made of: what a driver sees, how safe a speed is, who may be where and when."""
