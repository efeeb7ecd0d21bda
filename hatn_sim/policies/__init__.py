"""Policies that were learnt by driving: what they see, what they may do, and who drives them."""
