"""Every effect at every place against every other, judged by fitted and held-out recordings."""
