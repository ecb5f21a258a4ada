"""From where a reconstruction goes on, and whether it still may."""
