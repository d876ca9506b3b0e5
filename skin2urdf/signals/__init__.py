"""Recording -> features: rests, neighbourhoods, regression (paper II-A.3, II-C.2)."""
