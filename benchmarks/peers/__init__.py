"""Other people's codes on the same task, each set up as its documentation advises."""
