"""What noise leaves in the loop, and how loud it is where."""
