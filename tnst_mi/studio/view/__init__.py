"""What a tab sees of what is opened: `sight`, then `painting`."""
