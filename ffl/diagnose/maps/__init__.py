"""What has no name: smooth maps, what they depend on, commands that did not arrive."""
