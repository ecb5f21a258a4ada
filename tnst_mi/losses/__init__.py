"""What a picture of the smoke should look like: `terms` (Eq. 5 to 7), their weighted sum (`objective`), and the
pictures that they take their targets from (`pictures`)."""
