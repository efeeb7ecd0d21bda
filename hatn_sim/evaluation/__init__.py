"""Many runs at once, and the tables of the paper beside ours."""
