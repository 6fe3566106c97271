"""Network benchmarks: sessions, sending, estimation and rate adaptation, in virtual and real time."""
