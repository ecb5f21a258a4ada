"""From what an artist has chosen to a recipe and a command line (`commands`), and the tables of keys (`parameters`)."""
