"""Features and a tree -> estimate: closed-form starts, NLopt, refinement, observability."""
