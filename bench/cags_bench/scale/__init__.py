"""How many sessions several servers behind a balancer carry, in virtual time."""
