"""What can be compared, and how images and derivatives of it are taken."""
