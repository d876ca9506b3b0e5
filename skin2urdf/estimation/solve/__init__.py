"""From starts to the optimum: NLopt progressively, Gauss-Newton, CasADi."""
