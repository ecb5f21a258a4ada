"""What is changed until its renderings are the pictures: extinction, velocity and colours."""
