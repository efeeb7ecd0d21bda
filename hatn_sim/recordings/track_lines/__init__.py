"""Reference lines from where people drove: lanes drawn from unlabelled tracks of a site."""
