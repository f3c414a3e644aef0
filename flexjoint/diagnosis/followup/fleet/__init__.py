"""Many robots over time: every recording checked, those that changed diagnosed, one page of who needs
somebody"""
