"""How many sessions several servers behind a balancer can carry, in virtual time."""
