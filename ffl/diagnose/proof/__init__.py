"""What it comes to: verdict, proof on held-out recordings, and the experiment that would tell more."""
