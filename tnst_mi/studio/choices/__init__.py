"""What can be chosen on the page, and set: `motifs` and `settings` first."""
