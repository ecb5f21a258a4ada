"""What artists see (`panel`, `lists`, `preferences`) and press (`run_operators`)."""
