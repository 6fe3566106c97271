"""One client without IO: protocol session, planning in time, messages."""
