"""How the stream holds on a network: sessions, sending, estimation and rate adaptation, in virtual and in real time."""
